// What the page shows of a scene's light, and basic edits, against the service's own pictures.

import { createHash } from 'node:crypto';
import { difference, patch } from './pictures.mjs';

/** Light comes with its noise averaged away unless it is not wanted so: in both cases what a download gives, bit for bit. */
async function filtered({ page, check, client, scene }) {
  const { ElementMap, readFrames } = await import(new URL('../../clients/js/dist/index.js', import.meta.url));
  const shows = async (filter) => {
    const whole = new ElementMap();
    whole.apply(readFrames(await client.lightMap(scene.id, { format: 'raw', filter })));
    const wanted = createHash('sha256').update(new Uint8Array(whole.values.buffer)).digest('hex');
    await page.waitForFunction(async (wanted) => {
      const digest = await crypto.subtle.digest('SHA-256', window.rebake.map.current);
      return [...new Uint8Array(digest)].map((byte) => byte.toString(16).padStart(2, '0')).join('') === wanted;
    }, wanted);
    return wanted;
  };
  const smooth = await shows('statistical');
  await page.locator('#filter').uncheck();
  check(smooth !== (await shows('none')), 'light is shown as it was computed');
  await page.locator('#filter').check();
  check(smooth === (await shows('statistical')), 'and with its noise averaged away, which is how it comes');
}

export async function checkLight({ page, room, objectName, check, shot, state, canvas, rendered, settled, project, choose, client, scene }) {
  // The page and the service agree on what the room looks like: the median over a grid of the pixels' difference.
  const [seen, drawn] = [await canvas(), await rendered()];
  const median = difference(seen, drawn);
  check(median < 4, `page and service show the same room (median ${median.toFixed(2)} of 255)`);

  await filtered({ page, check, client, scene });

  // Under the object: a point of the floor in the middle of its footprint.
  const { bounds } = scene.objects.find((o) => o.name === objectName);
  const floor = Math.min(...scene.objects.map((o) => o.bounds.min[1]));
  const under = [(bounds.min[0] + bounds.max[0]) / 2, floor, (bounds.min[2] + bounds.max[2]) / 2];
  await choose('objects', objectName);
  await shot('3-selected');
  await page.locator('#canvas').focus();
  await page.keyboard.press('Delete');
  await page.waitForFunction((n) => !window.rebake.state().scene.objects.some((o) => o.name === n), objectName);
  await settled();
  await shot('4-removed');
  const at = await project(under);
  const [now, after] = [patch(await canvas(), at), patch(await rendered(), at)];
  check(Math.abs(now - after) < 8, `under the removed object the page shows ${now.toFixed(1)}, the service ${after.toFixed(1)}`);
  const was = patch(drawn, at);
  check(Math.abs(now - patch(seen, at) - (after - was)) < 12, `and changed by ${(now - patch(seen, at)).toFixed(1)}, the service by ${(after - was).toFixed(1)}`);

  await page.selectOption('#view', 'change');
  await shot('5-change');
  const red = (await canvas()).at(Math.round(at[0] * seen.width), Math.round(at[1] * seen.height));
  check(red[0] > red[2] + 20, `where the object stood the change is shown as brighter (${red})`);
  await page.selectOption('#view', 'error');
  await page.locator('#picture').waitFor({ state: 'visible' });
  await shot('6-error');
  const errors = await page.locator('#picture').getAttribute('src');
  await page.selectOption('#view', 'elements');
  await page.waitForFunction((errors) => !document.getElementById('picture').hidden && document.getElementById('picture').src !== errors, errors);
  await shot('6a-elements');
  // The service's own picture: there at once, and better after that.
  await page.selectOption('#view', 'picture');
  await page.waitForFunction(() => document.getElementById('picture').dataset.samples === '16');
  await shot('6b-picture');
  check(true, 'a picture gets better while one looks');
  await page.selectOption('#view', 'indirect');
  await page.locator('#picture').waitFor({ state: 'hidden' });
  await shot('7-indirect');
  await page.selectOption('#view', 'full');
  await page.keyboard.press('Escape');
  const whole = await canvas();
  await page.locator('#split').check();
  const left = await canvas();
  await shot('8-split');
  // What stood there is on the left, with its light of then; the right is as it was without the split.
  const inside = [0.48, 0.5];
  check(Math.abs(patch(left, inside) - patch(seen, inside)) < 6 && Math.abs(patch(left, inside) - patch(whole, inside)) > 20, 'the split view shows the removed object on its left');
  check(Math.abs(patch(left, [0.75, 0.5]) - patch(whole, [0.75, 0.5])) < 3, 'and what is there now on its right');
  await page.locator('#split').uncheck();

  // Undo brings the object back, with its light.
  await page.locator('#undo').click();
  await page.waitForFunction((n) => window.rebake.state().scene.objects.some((o) => o.name === n), objectName);
  await settled();
  const back = await canvas();
  check(Math.abs(patch(back, at) - patch(seen, at)) < 10, 'undo shows what was there before');
  await shot('9-undone');

  // The gizmo: along x, by its arrow, wherever that is on the screen.
  await choose('objects', objectName);
  const placed = () => page.evaluate((n) => window.rebake.state().scene.objects.find((o) => o.name === n).bounds, objectName);
  const bounds0 = await placed();
  const middle = bounds0.min.map((low, k) => (low + bounds0.max[k]) / 2);
  const box = await page.locator('#stage').boundingBox();
  const screen = async (point) => {
    const [u, v] = await project(point);
    return [box.x + u * box.width, box.y + v * box.height];
  };
  const [from, to] = [await screen(middle), await screen([middle[0] + 1, middle[1], middle[2]])];
  const along = (t) => [from[0] + (to[0] - from[0]) * t, from[1] + (to[1] - from[1]) * t];
  let grip = 0;
  for (let t = 0.15; t < 1.5 && !grip; t += 0.02) {
    await page.mouse.move(...along(t));
    if ((await page.evaluate(() => window.rebake.stage.gizmo.axis)) === 'X') grip = t;
  }
  check(grip > 0, 'the gizmo has an arrow along x');
  await page.selectOption('#grid', '0.25');
  await page.mouse.down();
  for (let k = 1; k <= 5; k++) await page.mouse.move(...along(grip + 0.1 * k));
  await page.mouse.up();
  await page.waitForFunction(([n, x]) => window.rebake.state().scene.objects.find((o) => o.name === n).bounds.min[0] > x + 0.2, [objectName, bounds0.min[0]]);
  await settled();
  const bounds1 = await placed();
  await page.selectOption('#grid', '0');
  const steps = (bounds1.min[0] - bounds0.min[0]) / 0.25;
  check(Math.abs(steps - Math.round(steps)) < 1e-3, 'it goes in steps of the grid');
  check(Math.abs(bounds1.min[1] - bounds0.min[1]) < 1e-4 && Math.abs(bounds1.max[2] - bounds0.max[2]) < 1e-4, `the object moved along x, by ${(bounds1.min[0] - bounds0.min[0]).toFixed(2)} m, and not else`);
  await shot('9b-moved');
  await page.locator('#undo').click();
  await page.waitForFunction(([n, x]) => Math.abs(window.rebake.state().scene.objects.find((o) => o.name === n).bounds.min[0] - x) < 1e-4, [objectName, bounds0.min[0]]);
  await page.locator('#redo').click();
  await page.waitForFunction(([n, x]) => Math.abs(window.rebake.state().scene.objects.find((o) => o.name === n).bounds.min[0] - x) < 1e-4, [objectName, bounds1.min[0]]);
  await page.locator('#undo').click();
  await page.waitForFunction(([n, x]) => Math.abs(window.rebake.state().scene.objects.find((o) => o.name === n).bounds.min[0] - x) < 1e-4, [objectName, bounds0.min[0]]);
  await settled();
  check(true, 'a move is undone and redone');

  // Without a mouse: the object's place as numbers, and the focus stays where it was.
  const field = page.getByLabel('Position z, metres');
  await page.waitForFunction(([f, z]) => Math.abs(f.value - z) < 0.006, [await field.elementHandle(), middle[2]]);
  await field.focus();
  await field.fill(((bounds0.min[2] + bounds0.max[2]) / 2 + 0.5).toFixed(2));
  await page.keyboard.press('Enter');
  await page.waitForFunction(([n, z]) => Math.abs(window.rebake.state().scene.objects.find((o) => o.name === n).bounds.min[2] - z - 0.5) < 0.02, [objectName, bounds0.min[2]]);
  await settled();
  check(await field.evaluate((f) => f === document.activeElement), 'an object is moved by the keyboard, and the focus stays');
  await page.locator('#undo').click();
  await page.waitForFunction(([n, z]) => Math.abs(window.rebake.state().scene.objects.find((o) => o.name === n).bounds.min[2] - z) < 1e-4, [objectName, bounds0.min[2]]);
  await settled();

  // Cancel, before anything else: with so many samples the job goes on until then, on any machine.
  const lasting = (route) => route.continue({ postData: JSON.stringify({ ...route.request().postDataJSON(), budget: { samples_per_element: 8_000 } }) });
  await page.setInputFiles('#asset-file', room);
  await page.route('**/edits', lasting);
  await page.locator(`#assets [data-name="${room.split('/').at(-1).replace('.glb', '')}"]`).click();
  await page.locator('#job button', { hasText: 'Cancel' }).click();
  await page.unroute('**/edits', lasting);
  await page.waitForFunction(() => window.rebake.state().jobs[0].state === 'canceled');
  check((await page.locator('#job').textContent()).includes('canceled'), 'a running job is canceled');
  await page.locator('#undo').click();
  await page.waitForFunction((n) => window.rebake.state().scene.objects.length === n, scene.objects.length);
  await settled();
  const cleared = await canvas();
  check(Math.abs(patch(cleared, [0.5, 0.9]) - patch(seen, [0.5, 0.9])) < 10, 'undo takes out what a canceled job put in');

  // A slider: the first light at half its intensity, and back.
  const lightOf = async () => (await state()).scene.lights[0];
  const light = await lightOf();
  await page.locator('#lights [role=option]').first().click();
  const bright = patch(await canvas(), [0.5, 0.85]);
  const slider = page.getByRole('slider', { name: 'Intensity' });
  await slider.fill('-1');
  await page.waitForFunction((i) => window.rebake.state().scene.lights[0].intensity < 0.7 * i, light.intensity);
  await settled();
  const dim = patch(await canvas(), [0.5, 0.85]);
  check(dim < bright - 5, `a light at half is darker on the screen (${bright.toFixed(1)} to ${dim.toFixed(1)})`);
  await shot('10-dimmed');
  await page.keyboard.press('Control+z');
  await page.waitForFunction((i) => window.rebake.state().scene.lights[0].intensity === i, light.intensity);
  await settled();
  check((await lightOf()).intensity === light.intensity, 'undo restores the light');

  // It has a layer of its own by now: one can look at that alone, and its slider does not wait for the service.
  const layer = (await lightOf()).layer;
  await page.selectOption('#view', `layer ${layer}`);
  await page.waitForFunction(() => window.rebake.state().view.startsWith('layer '));
  check(patch(await canvas(), [0.5, 0.85]) > 5, 'a layer is shown alone');
  await page.selectOption('#view', 'full');
  await page.waitForFunction(() => window.rebake.relighting.isReady(window.rebake.state().version));
  let release;
  const held = new Promise((done) => (release = done));
  await page.route('**/edits', async (route) => {
    await held;
    await route.continue();
  });
  await slider.fill('-1');
  await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
  const early = patch(await canvas(), [0.5, 0.85]);
  check((await lightOf()).intensity === light.intensity && early < bright - 5, 'the page dims it before the service answers');
  release();
  await page.waitForFunction((i) => window.rebake.state().scene.lights[0].intensity < 0.7 * i, light.intensity);
  await settled();
  const late = patch(await canvas(), [0.5, 0.85]);
  check(Math.abs(late - early) < 1, `as the service does (${early.toFixed(1)} and ${late.toFixed(1)})`);
  await page.unroute('**/edits');
  await page.keyboard.press('Control+z');
  await page.waitForFunction((i) => window.rebake.state().scene.lights[0].intensity === i, light.intensity);
  await settled();

  // Held while somebody else edits the scene, a slider stays in the hand.
  const handle = await slider.boundingBox();
  const across = (t) => [handle.x + handle.width * t, handle.y + handle.height / 2];
  await page.mouse.move(...across(0.5));
  await page.mouse.down();
  await page.mouse.move(...across(0.4));
  const other = await client.edit(scene.id, { op: 'material', object: objectName, albedo: [0.5, 0.1, 0.1] });
  await page.waitForFunction((n) => window.rebake.state().scene.accepted_edits >= n, other.accepted_edits);
  await settled();
  await page.mouse.move(...across(0.2));
  await page.mouse.up();
  await page.waitForFunction((i) => window.rebake.state().scene.lights[0].intensity < 0.6 * i, light.intensity);
  check(true, 'a slider can be held while somebody else edits');
  await settled();
  await page.keyboard.press('Control+z');
  await page.waitForFunction((i) => window.rebake.state().scene.lights[0].intensity === i, light.intensity);
  await settled();
  await page.locator('#undo').click();
  await page.waitForFunction((n) => window.rebake.state().scene.objects.find((o) => o.name === n).albedo[0] < 0.3, objectName);
  await settled();
}
