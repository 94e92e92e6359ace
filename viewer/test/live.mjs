// The client in clients/js: its README's script against the service, and its example page, with the light map at vertices
// and as an atlas, held against the service's own pictures, before and after an edit by somebody else.

import { execFile } from 'node:child_process';
import { copyFile, mkdtemp, readFile, rm } from 'node:fs/promises';
import { tmpdir } from 'node:os';
import { join, normalize } from 'node:path';
import { fileURLToPath } from 'node:url';
import { promisify } from 'node:util';
import { decodePng, difference } from './pictures.mjs';

const CLIENT = fileURLToPath(new URL('../../clients/js/', import.meta.url));
const PACKAGES = fileURLToPath(new URL('../node_modules/', import.meta.url));
const KINDS = { html: 'text/html', js: 'text/javascript', glb: 'model/gltf-binary' };

/** Serves the example as if it lay beside `node_modules` with the client and three.js, under the service's address. */
async function serve(page, base, room) {
  await page.route(`${base}/live/**`, async (route) => {
    const path = normalize(decodeURIComponent(new URL(route.request().url()).pathname)).slice('/live/'.length);
    const [, name, rest] = /^node_modules\/(rebake|three)\/(.*)$/.exec(path) ?? [];
    const file = name ? join(name === 'rebake' ? CLIENT : join(PACKAGES, name), rest) : path === 'room.glb' ? room : join(CLIENT, 'examples', path);
    await route.fulfill({ body: await readFile(file), contentType: KINDS[file.split('.').at(-1)] ?? 'text/plain' });
  });
}

export async function checkLive({ page, base, token, room, objectName, check, shot, client }) {
  const { ElementMap, readFrames } = await import(new URL('../../clients/js/dist/index.js', import.meta.url));
  await readme(base, token, room, objectName, check);
  await serve(page, base, room);
  await page.setViewportSize({ width: 480, height: 300 });
  for (const [layout, settings] of [['vertices', {}], ['atlas', { layout: 'atlas', texels_per_metre: 16 }]]) {
    const uploaded = await client.upload(await readFile(room), { name: layout, spacing: 0.2, target: { samples_per_element: 32 }, ...settings });
    await client.finished(uploaded.current_job);
    const query = new URLSearchParams({ server: base, scene: uploaded.id, file: 'room.glb', ...(token && { token }) });
    await page.goto(`${base}/live/live.html?${query}`);
    const shown = (version) => page.waitForFunction((v) => window.three?.light.version >= v, version);
    const agrees = async (what) => {
      await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
      const view = await page.evaluate(() => {
        const { camera, orbit } = window.three;
        return { eye: camera.position.toArray(), target: orbit.target.toArray(), up: camera.up.toArray(), fov_y: (camera.fov * Math.PI) / 180 };
      });
      const answer = await client.render(uploaded.id, { ...view, width: 480, height: 300, spp: 16, exposure: 0 });
      const [seen, drawn] = [decodePng(await page.locator('canvas').screenshot()), decodePng(Buffer.from(await answer.arrayBuffer()))];
      const median = difference(seen, drawn);
      check(median < 4, `three.js with light ${layout === 'atlas' ? 'on an atlas' : 'at vertices'} shows what the service does, ${what} (median ${median.toFixed(2)} of 255)`);
      return seen;
    };
    await shown((await client.scene(uploaded.id)).version);
    const before = await agrees('after its bake');
    await shot(`13-live-${layout}`);
    const job = await client.edit(uploaded.id, { op: 'remove', objects: [objectName], budget: { samples_per_element: 16 } });
    const { progress } = await client.finished(job.id);
    await shown(progress.version);
    await page.waitForFunction((name) => !window.three.light.scene.objects.some((o) => o.name === name), objectName);
    const after = await agrees('and after an edit');
    check(difference(before, after) > 0.3, 'which can be seen');
    if (layout === 'vertices') {
      const [whole, steps] = [new ElementMap(), new ElementMap()];
      whole.apply(readFrames(await client.lightMap(uploaded.id, { format: 'raw' })));
      for await (const event of client.follow(uploaded.id)) {
        if (event.type === 'snapshot') steps.apply(event.frames);
        if (steps.version >= whole.version) break;
      }
      check(Buffer.from(whole.values.buffer).equals(Buffer.from(steps.values.buffer)), 'a stream adds up to the whole map, bit for bit');
    }
    await client.delete(uploaded.id);
  }
}

/** Runs the first script of the README as it is printed. */
async function readme(base, token, room, objectName, check) {
  const text = await readFile(join(CLIENT, 'README.md'), 'utf8');
  const script = /```js\n([\s\S]*?)```/.exec(text)[1].replace("'sofa'", `'${objectName}'`);
  const folder = await mkdtemp(join(tmpdir(), 'rebake-readme-'));
  try {
    await copyFile(room, join(folder, 'room.glb'));
    // From within the package its name means itself; the file that it reads is in the folder.
    const code = `process.chdir(${JSON.stringify(folder)});\n${script.replace(/^import .* from 'rebake';$/m, '')}`;
    const whole = `import { ElementMap, Rebake } from 'rebake';\n${code}`;
    const run = promisify(execFile)('node', ['--input-type=module', '--eval', whole], {
      cwd: CLIENT, timeout: 60_000, env: { ...process.env, REBAKE: base, TOKEN: token ?? '' },
    });
    const { stdout } = await run;
    check(/stated error 0\.\d+/.test(stdout) && /version \d+ has \d+ elements/.test(stdout), "the client's README runs as printed");
  } finally {
    await rm(folder, { recursive: true, force: true });
  }
}
