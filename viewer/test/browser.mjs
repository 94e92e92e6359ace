// Drives the page in a real browser: uploads a room, edits it, and holds what is on the screen against what the
// service's own pictures say. Started by `tests/api/browser.rs`; by hand, against a service with the page in it:
//
//   node viewer/test/browser.mjs http://127.0.0.1:7878 room.glb object viewer/screenshots
//
// TOKEN is what the service asks for, if it does. CHROMIUM names the browser. PAGE_DIR serves the page's files from a directory instead of from the service.
// Where standard input is connected, "restart" on standard output asks for a restart of the service, and a line back
// says that it is done.

import { mkdir } from 'node:fs/promises';
import { join } from 'node:path';
import { createInterface } from 'node:readline';
import { launch } from './launch.mjs';
import { checkLight } from './light.mjs';
import { checkLive } from './live.mjs';
import { decodePng } from './pictures.mjs';
import { checkScenes } from './scenes.mjs';
import { checkTools } from './tools.mjs';

const [base, room, objectName, shots] = process.argv.slice(2);
const PATIENCE = 120_000;
const token = process.env.TOKEN;

function check(is, text) {
  if (!is) throw new Error(text);
  console.log(`ok: ${text}`);
}

await mkdir(shots, { recursive: true });
const { page, close } = await launch(base, { width: 1280, height: 720 });
const lines = createInterface({ input: process.stdin })[Symbol.asyncIterator]();
try {
  page.setDefaultTimeout(PATIENCE);
  const errors = [];
  page.on('pageerror', (error) => errors.push(String(error)));
  // The service asks for a token: first a wrong one, then the right one.
  const answers = token ? ['0123456789abcdef-wrong', token] : [];
  page.on('dialog', (dialog) => void dialog.accept(answers.shift()));
  const state = () => page.evaluate(() => window.rebake.state());
  const shot = (name) => page.screenshot({ path: join(shots, `${name}.png`) });
  const canvas = async () => decodePng(await page.locator('#stage').screenshot());
  /** Until everything is lit and shown. */
  const settled = async () => {
    await page.waitForFunction(() => {
      const { scene, version, jobs, fresh } = window.rebake.state();
      const over = jobs.length > 0 && jobs.every((j) => !['queued', 'running'].includes(j.state));
      const newest = Math.max(...jobs.map((j) => j.progress.version ?? 0));
      return over && fresh && version >= newest && scene.elements_version <= version;
    }, null, { timeout: PATIENCE, polling: 100 });
    // Two frames: the last values are on the screen.
    await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
  };
  /** The service's own picture from the page's camera. */
  const rendered = async () => {
    const url = await page.evaluate((base) => {
      const { stage, state } = window.rebake;
      const { scene, exposure } = state();
      const view = stage.view();
      const query = new URLSearchParams({ ...view, eye: view.eye.join(), target: view.target.join(), up: view.up.join() });
      return `${base}/v1/scenes/${scene.id}/render?${query}&exposure=${exposure}&spp=16`;
    }, base);
    const answer = await fetch(url, { headers: token ? { authorization: `Bearer ${token}` } : {} });
    if (!answer.ok) throw new Error(await answer.text());
    return decodePng(Buffer.from(await answer.arrayBuffer()));
  };
  /** Where a world-space point is in the picture, in parts of it. */
  const project = (point) => page.evaluate((p) => window.rebake.stage.project(p), point);

  /** Uploads a file by way of its dialog; answers what it said about it. */
  const upload = async (file, settings = {}) => {
    await page.setInputFiles('#file', file);
    for (const [id, value] of Object.entries({ samples: 32, ...settings })) {
      const field = page.locator(`#up-${id}`);
      if (await field.evaluate((f) => f instanceof HTMLSelectElement)) await field.selectOption(String(value));
      else await field.fill(String(value));
    }
    await page.waitForFunction(() => document.getElementById('up-plan').ariaBusy === 'false');
    const said = await page.locator('#up-plan').textContent();
    const before = (await state()).scene?.id;
    await page.locator('#up-ok').click();
    await page.waitForFunction((id) => window.rebake.state().scene && window.rebake.state().scene.id !== id, before);
    await settled();
    return said;
  };
  /** Selects something in a list. */
  const choose = (list, name, modifiers = []) => page.locator(`#${list} [data-name="${name}"]`).click({ modifiers });
  await page.goto(base);
  await page.waitForFunction(() => document.getElementById('status').textContent.startsWith('Ready'));
  await shot('1-empty');
  await upload(room, { spacing: 0.1 });
  await page.locator('#exposure').fill('-0.5');
  const { scene } = await state();
  check(scene.objects.some((o) => o.name === objectName), 'the room is there after the upload');
  await shot('2-room');
  const { Rebake } = await import(new URL('../../clients/js/dist/index.js', import.meta.url));
  const client = new Rebake(base, { token });
  const about = { page, base, token, room, objectName, check, shot, state, canvas, rendered, settled, project, choose, upload, client, scene };
  const parts = { light: checkLight, tools: checkTools, scenes: checkScenes };
  // ONLY names parts of it: for those who work on one.
  const wanted = process.env.ONLY?.split(',');
  for (const [name, part] of Object.entries(parts)) if (!wanted || wanted.includes(name)) await part(about);

  // What the service refuses is said in words.
  await page.setInputFiles('#file', { name: 'no.glb', mimeType: 'model/gltf-binary', buffer: Buffer.from('nothing') });
  await page.waitForFunction(() => document.getElementById('up-plan').textContent.includes('Malformed'));
  check(true, 'a refused upload is explained');
  await page.keyboard.press('Escape');

  if (process.env.CAN_RESTART) {
    console.log('stop');
    await lines.next();
    await page.waitForFunction(() => document.getElementById('banner').textContent.includes('connection is lost'));
    await shot('11-offline');
    console.log('start');
    await lines.next();
    // Scenes live in memory: after a restart this one is gone, and the page says so and goes on.
    await page.waitForFunction(() => document.getElementById('banner').textContent.includes('no longer has this scene'));
    await shot('12-restarted');
    await upload(room, { spacing: 0.1 });
    check((await state()).scene.id !== scene.id, 'after a restart of the service the page works on');
  }
  if (!wanted || wanted.includes('live')) await checkLive(about);
  check(errors.length === 0, `no error in the page ${errors.join('; ')}`);
  console.log('done');
} catch (error) {
  await page.screenshot({ path: join(shots, 'failed.png') }).catch(() => {});
  console.log(`failed: ${error.stack}`);
  process.exitCode = 1;
} finally {
  await close();
  process.exit();
}
