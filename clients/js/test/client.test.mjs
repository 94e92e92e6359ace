// Requests and streams against answers made here.

import assert from 'node:assert/strict';
import { test } from 'node:test';
import { LAST, REPLACE, Rebake, Refused, Unreachable } from '../dist/index.js';
import { frame } from './frame.mjs';

/** A client whose requests are answered by a function of path and request; what it asked stands in `asked`. */
function client(answer, options = {}) {
  const asked = [];
  const fetch = async (url, init = {}) => {
    const { pathname, search } = new URL(url);
    asked.push({ path: pathname + search, ...init });
    return answer({ path: pathname + search, ...init }, asked.length);
  };
  return { asked, rebake: new Rebake('http://service/', { fetch, ...options }) };
}

const json = (value, status = 200) => Response.json(value, { status });
const body = (...chunks) => new Response(new ReadableStream({
  start(controller) {
    for (const chunk of chunks) controller.enqueue(new Uint8Array(chunk));
    controller.close();
  },
}));

test('an edit carries its key, what it was made for, and what it is told beside', async () => {
  const { asked, rebake } = client(() => json({ id: 'j1' }, 202));
  await rebake.edit('s 1', { op: 'undo' }, { ifMatch: 7, idempotencyKey: 'k', priority: 'high' });
  const [{ path, method, headers, body }] = asked;
  assert.equal(`${method} ${path}`, 'POST /v1/scenes/s%201/edits');
  assert.equal(headers['if-match'], '"7"');
  assert.equal(headers['idempotency-key'], 'k');
  assert.deepEqual(JSON.parse(body), { op: 'undo', priority: 'high' });
  await rebake.edit('s', [{ op: 'remove', objects: ['a'] }]);
  assert.deepEqual(JSON.parse(asked[1].body), { edits: [{ op: 'remove', objects: ['a'] }] });
  assert.equal(asked[1].headers['if-match'], undefined);
});

test('a refusal is told in words, with its field', async () => {
  const problem = { type: '/problems/invalid-value', title: 'Invalid value', detail: 'spacing: has to be above 0', field: 'spacing' };
  const { rebake } = client(() => json(problem, 422));
  await assert.rejects(rebake.upload(new Blob([]), { spacing: -1 }), (error) => {
    assert(error instanceof Refused);
    assert.deepEqual([error.status, error.type, error.field], [422, '/problems/invalid-value', 'spacing']);
    return error.message === 'Invalid value: spacing: has to be above 0';
  });
});

test('a service that is away is told apart from one that refuses', async () => {
  const { rebake } = client(() => Promise.reject(new TypeError('no route')));
  await assert.rejects(rebake.scenes(), Unreachable);
});

test('a token is asked for once, and again where it does not do', async () => {
  const tried = [];
  const askToken = (wrong) => (tried.push(wrong), ['bad', 'good'][tried.length - 1] ?? null);
  const known = ({ headers }) => (headers.authorization === 'Bearer good' ? json({ items: [] }) : json({ title: 'Unauthorized' }, 401));
  const { rebake } = client(known, { askToken });
  assert.deepEqual(await rebake.scenes(), []);
  assert.deepEqual(tried, [null, 'bad']);
  const locked = client(() => json({ title: 'Unauthorized' }, 401)).rebake;
  await assert.rejects(locked.scenes(), (error) => error.status === 401);
});

test('lists are read to their end', async () => {
  const { asked, rebake } = client(({ path }) =>
    path.includes('cursor=b') ? json({ items: [3] }) : json({ items: [1, 2], next_cursor: 'b' }));
  assert.deepEqual(await rebake.jobs('s1'), [1, 2, 3]);
  assert.deepEqual(asked.map((a) => a.path), ['/v1/jobs?scene=s1', '/v1/jobs?scene=s1&cursor=b']);
});

test('settings of an upload become its query', async () => {
  const { asked, rebake } = client(() => json({}));
  const settings = { name: 'a b', environment: [1, 0.5, 0], target: { max_seconds: 2 }, layers: { up: ['lamp'] }, default_sky: true };
  await rebake.plan(new File([], 'x.zip'), settings);
  const query = Object.fromEntries(new URL(`http://x${asked[0].path}`).searchParams);
  assert.deepEqual(query, {
    name: 'a b', environment: '1,0.5,0', target: '{"max_seconds":2}', layers: '{"up":["lamp"]}', default_sky: 'true', dry_run: 'true',
  });
  assert.equal(asked[0].headers['content-type'], 'application/zip');
});

test('a stream comes back by itself with the last whole snapshot, and starts anew in another life of the service', async () => {
  const one = frame({ flags: LAST | REPLACE, base: 0, version: 4, runs: [[0, 1]], values: [1, 2, 3] });
  const half = frame({ flags: 0, base: 4, version: 5, runs: [[0, 1]], values: [4, 5, 6] });
  const two = frame({ flags: LAST | REPLACE, base: 0, version: 1, runs: [[0, 1]], values: [7, 8, 9] });
  const answers = [body(one, half), json({ title: 'Conflict' }, 409), body(two), json({ title: 'Not found' }, 404)];
  const { asked, rebake } = client((_, n) => answers[n - 1]);
  const heard = [];
  for await (const event of rebake.follow('s1', { filter: 'statistical' })) {
    heard.push(event.type === 'snapshot' ? `${event.version}: ${[...event.frames.at(-1).values]}` : event.type);
  }
  assert.deepEqual(heard, ['online', '4: 1,2,3', 'offline', 'online', '1: 7,8,9', 'offline', 'gone']);
  const of = (name) => asked.map((a) => new URLSearchParams(a.path.split('?')[1]).get(name));
  assert.deepEqual(of('since'), ['0', '4', '0', '1']);
  assert.deepEqual(of('filter'), Array(4).fill('statistical'), 'of values that are filtered alike');
});

test('events go on behind the last one', async () => {
  const text = (value) => body(new TextEncoder().encode(value));
  const answers = [text('event: job\nid: 7\ndata: {"a":1}\n\nevent: jo'), text('id: 8\nevent: scene\ndata: {"b":\ndata: 2}\n\n'), json({}, 404)];
  const { asked, rebake } = client((_, n) => answers[n - 1]);
  const heard = [];
  for await (const event of rebake.events('s1')) heard.push(event);
  assert.deepEqual(heard, [{ type: 'job', id: '7', data: { a: 1 } }, { type: 'scene', id: '8', data: { b: 2 } }]);
  assert.deepEqual(asked.map((a) => a.headers['last-event-id']), [undefined, '7', '8']);
});
