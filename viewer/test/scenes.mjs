// Scenes as a whole: settings of an upload, no light, pause, names, files, the end; a small window.

import { readFile } from 'node:fs/promises';
import { patch } from './pictures.mjs';

export async function checkScenes(about) {
  await small(about);
  await dark(about);
  await pause(about);
  await scene(about);
}

/** The file without what shines in it. */
async function unlit(room) {
  const bytes = await readFile(room);
  const length = bytes.readUInt32LE(12);
  const document = JSON.parse(bytes.toString('utf8', 20, 20 + length));
  for (const material of document.materials) {
    delete material.emissiveFactor;
    delete material.extensions;
  }
  delete document.extensionsUsed;
  // Of the same length, so that nothing else changes.
  bytes.write(JSON.stringify(document).padEnd(length, ' '), 20);
  return bytes;
}

async function small({ page, check, shot }) {
  await page.setViewportSize({ width: 1024, height: 640 });
  await page.locator('#objects [data-name]').nth(1).click();
  await shot('30-small');
  const fits = await page.evaluate(() => {
    const stage = document.getElementById('stage').getBoundingClientRect();
    return document.documentElement.scrollHeight <= innerHeight && document.documentElement.scrollWidth <= innerWidth && stage.width >= 540 && stage.height >= 480;
  });
  check(fits, 'all of it fits 1024 × 640, and most of that is the scene');
  await page.setViewportSize({ width: 1280, height: 720 });
}

async function dark({ page, check, shot, room, canvas, settled, upload, state, client }) {
  const file = { name: 'dark.glb', mimeType: 'model/gltf-binary', buffer: await unlit(room) };
  // Its bake has nothing to do, and may end before the page hears of anything: here it always does.
  const late = '**/v1/scenes/*/events';
  await page.route(late, async (route) => {
    const [, scene] = /scenes\/([^/]+)/.exec(route.request().url());
    for (const job of await client.jobs(scene)) await client.finished(job.id);
    await route.continue();
  });
  const said = await upload(file, { spacing: 0.2, name: 'dark room' });
  await page.unroute(late);
  check(said.includes('one per 0.20 m') && said.includes('no light'), 'the upload tells what it would take, and that there is no light');
  check(Math.abs((await state()).scene.spacing - 0.2) < 1e-6, 'and takes the settings');
  await page.locator('#banner button', { hasText: 'Add a sky' }).waitFor();
  const before = patch(await canvas(), [0.5, 0.85]);
  await shot('31-dark');
  // It is a closed room: a lamp is of more use in it.
  await page.locator('#banner button', { hasText: 'Add a lamp' }).click();
  await page.waitForFunction(() => window.rebake.state().scene.lights.some((l) => l.kind === 'point'));
  await settled();
  const after = patch(await canvas(), [0.5, 0.85]);
  await shot('32-lamp');
  check(before < 2 && after > 40 && after < 220, `a scene without light is offered some: ${before.toFixed(0)} before, ${after.toFixed(0)} of 255 after`);
}

async function pause({ page, check, settled, state, client }) {
  const { scene } = await state();
  await client.edit(scene.id, { op: 'move', object: scene.objects[1].name, transform: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0.1, 1] }, { budget: { samples_per_element: 8_000 } });
  const job = page.locator('#job');
  await job.locator('button', { hasText: 'Pause' }).click();
  await job.locator('button', { hasText: 'Continue' }).waitFor();
  await page.waitForFunction(() => window.rebake.state().jobs.some((j) => j.state === 'paused'));
  await job.locator('button', { hasText: 'Continue' }).click();
  await page.waitForFunction(() => window.rebake.state().jobs.some((j) => j.state === 'running'));
  check(true, 'work is paused and continued');
  for (const running of await client.jobs(scene.id)) if (['queued', 'running', 'paused'].includes(running.state)) await client.cancel(running.id);
  await page.waitForFunction(() => window.rebake.state().jobs.every((j) => !['queued', 'running', 'paused'].includes(j.state)));
  await settled();
}

async function scene({ page, check, shot, state, client }) {
  const { scene } = await state();
  await page.locator('#scene-more').click();
  await shot('33-scene');
  const [download] = await Promise.all([page.waitForEvent('download'), page.locator('#scene-files button').first().click()]);
  const file = await readFile(await download.path());
  check(download.suggestedFilename() === 'dark room-lit.glb' && file.toString('latin1', 0, 4) === 'glTF', 'a scene is exported');
  await page.locator('#scene-name').fill('bright room');
  await page.locator('#scene-ok').click();
  await page.waitForFunction(() => document.getElementById('scenes').selectedOptions[0].textContent === 'bright room');
  check((await client.scene(scene.id)).name === 'bright room', 'and renamed');
  await page.locator('#scene-more').click();
  await page.locator('#scene-delete button').click();
  await page.locator('#scene-delete button', { hasText: 'for good' }).click();
  await page.waitForFunction((id) => window.rebake.state().scene?.id !== id, scene.id);
  check(!(await client.scenes()).some((one) => one.id === scene.id), 'and deleted, after a second click');
}
