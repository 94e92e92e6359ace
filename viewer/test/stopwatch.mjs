// How long it takes from the release archive to a lit room of one's own, step by step, as docs/use.md tells:
//
//   docker/release.sh && node viewer/test/stopwatch.mjs target/package/rebake-*.tar.gz room.glb OBJECT [spacing]
//
// A person's own time, to find buttons and files, is not in it. For CHROMIUM see launch.mjs.

import { execFileSync, spawn } from 'node:child_process';
import { mkdtemp, readdir, rm } from 'node:fs/promises';
import { tmpdir } from 'node:os';
import { join, resolve } from 'node:path';
import { createInterface } from 'node:readline';
import { launch } from './launch.mjs';

const [archive, room, objectName, spacing = ''] = process.argv.slice(2);
const begin = performance.now();
let last = begin;

function step(what) {
  const now = performance.now();
  console.log(`${((now - last) / 1000).toFixed(1).padStart(6)} s  ${what}`);
  last = now;
}

const folder = await mkdtemp(join(tmpdir(), 'rebake-stopwatch-'));
execFileSync('tar', ['-xzf', resolve(archive), '-C', folder]);
step('the archive is unpacked');
const [name] = await readdir(folder);
const service = spawn(join(folder, name, 'rebake'), ['serve', '--listen', '127.0.0.1:0'], { stdio: ['ignore', 'pipe', 'ignore'] });
let close = async () => {};
try {
  let base = '';
  for await (const line of createInterface({ input: service.stdout })) {
    base = /^listening on (.*)$/.exec(line)?.[1] ?? '';
    if (base) break;
  }
  step('the service runs, and has told the address of its page');
  let page;
  ({ page, close } = await launch(base, { width: 1280, height: 720 }));
  page.setDefaultTimeout(300_000);
  last = performance.now();
  await page.goto(base);
  await page.waitForFunction(() => document.getElementById('status').textContent.startsWith('Ready'));
  step('the page is open');
  await page.setInputFiles('#file', room);
  await page.locator('#up-spacing').fill(spacing);
  await page.waitForFunction(() => document.getElementById('up-plan').ariaBusy === 'false');
  step(`the room was dropped, and what it takes is told: ${(await page.locator('#up-plan').textContent()).split(';')[0]}`);
  await page.locator('#up-ok').click();
  await page.waitForFunction(() => window.rebake.state().version > 0);
  step('Upload was pressed, and the first light is there');
  const rest = () => page.waitForFunction(() => {
    const { jobs, version, fresh, scene } = window.rebake.state();
    return jobs.length && fresh && version >= scene.version && jobs.every((job) => !['queued', 'running'].includes(job.state));
  });
  await rest();
  const stated = () => page.evaluate(() => window.rebake.state().scene.estimated_rmse.toPrecision(2));
  step(`it is lit to its target, stated error ${await stated()}`);
  await page.locator(`#objects [data-name="${objectName}"]`).click();
  const before = (await page.evaluate(() => window.rebake.state())).version;
  last = performance.now();
  await page.locator('#canvas').focus();
  await page.keyboard.press('Delete');
  await page.waitForFunction((version) => window.rebake.state().version > version, before);
  step(`${objectName} was removed, and the first light without it is there`);
  await page.waitForFunction((n) => !window.rebake.state().scene.objects.some((one) => one.name === n), objectName);
  await rest();
  step(`it is lit to its target, stated error ${await stated()}`);
} finally {
  await close();
  service.kill();
  await rm(folder, { recursive: true, force: true });
}
process.exit();
