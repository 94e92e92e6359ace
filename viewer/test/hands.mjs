// What is in somebody's hands: dragged, or half typed, while the scene goes on.

import { close, middle, undo } from './helpers.mjs';

/** Something is lit where it is dragged along, and the drag is one step of undo. */
async function dragged(about, kind, name, what) {
  const { page, check, settled, state, project } = about;
  const one = async () => (await state()).scene[`${kind}s`].find((found) => found.name === name);
  const where = (found) => found.position ?? middle(found);
  const [was, box] = [where(await one()), await page.locator('#stage').boundingBox()];
  const screen = async (p) => (await project(p)).map((x, k) => (k ? box.y + x * box.height : box.x + x * box.width));
  const [from, to] = [await screen(was), await screen([was[0] + 1, was[1], was[2]])];
  const along = (t) => [from[0] + (to[0] - from[0]) * t, from[1] + (to[1] - from[1]) * t];
  let grip = 0;
  for (let t = 0.05; t < 2 && !grip; t += 0.03) {
    await page.mouse.move(...along(t));
    if ((await page.evaluate(() => window.rebake.stage.gizmo.axis)) === 'X') grip = t;
  }
  const { accepted_edits } = (await state()).scene;
  const { version } = await state();
  await page.mouse.down();
  for (const step of [1, 2]) {
    await page.mouse.move(...along(grip + 0.1 * step));
    await page.waitForFunction((n) => window.rebake.state().scene.accepted_edits >= n, accepted_edits + step);
  }
  await page.waitForFunction((n) => window.rebake.state().version > n, version);
  check(await page.evaluate(() => window.rebake.stage.gizmo.isHeld), `${what} is lit where it is dragged along`);
  // It stands where it is held, whatever the service has published meanwhile.
  const [held, seen] = [await page.evaluate(() => window.rebake.stage.gizmo.by.elements[12]), await page.evaluate(([k, n]) => {
    const { objects, markers } = window.rebake.stage;
    const shown = k === 'light' ? markers.get(n) : objects.get(n);
    if (k === 'light') return shown.position.x;
    const mesh = shown.children[0];
    mesh.geometry.computeBoundingBox();
    const box = mesh.geometry.boundingBox.clone().applyMatrix4(mesh.matrixWorld);
    return (box.min.x + box.max.x) / 2;
  }, [kind, name])];
  check(close(seen, was[0] + held, 0.01), 'and is shown where it is held');
  await page.mouse.move(...along(grip + 0.5));
  await page.mouse.up();
  await page.waitForFunction(([k, n, x]) => {
    const found = window.rebake.state().scene[`${k}s`].find((item) => item.name === n);
    return (found.position?.[0] ?? (found.bounds.min[0] + found.bounds.max[0]) / 2) > x + 0.3;
  }, [kind, name, was[0]]);
  await settled();
  const rows = () => page.locator('#history li').allTextContents();
  check((await rows())[0] === `move ${name}` && (await rows())[1] !== `move ${name}`, 'its way is one row of the history');
  const before = (await state()).scene.accepted_edits;
  check(before >= accepted_edits + 3, 'of several requests');
  await page.locator('#undo').click();
  await page.waitForFunction((n) => window.rebake.state().scene.accepted_edits > n && window.rebake.state().fresh, before);
  await settled();
  check(where(await one()).every((x, k) => close(x, was[k], 1e-4)) && (await state()).scene.accepted_edits === before + 1, 'and is taken back at once');
}

export async function drag(about) {
  const { page, settled, state, objectName, choose } = about;
  const { scene } = await state();
  await page.selectOption('#add-light', 'point');
  await page.waitForFunction((n) => window.rebake.state().selected[0]?.name === 'point-1' && window.rebake.state().scene.lights.length > n, scene.lights.length);
  await settled();
  await dragged(about, 'light', 'point-1', 'a lamp');
  await undo(about);
  await choose('objects', objectName);
  await settled();
  await dragged(about, 'object', objectName, 'an object');
}

/** Updates take nothing out of anybody's hands. */
export async function updates(about) {
  const { page, check, choose, settled, objectName, client, scene, state } = about;
  await choose('objects', objectName);
  await page.evaluate((n) => Object.assign(document.querySelector(`#objects [data-name="${n}"]`), { isSame: true }), objectName);
  const field = page.getByLabel('Position x, metres');
  await field.fill('1.');
  const paint = async (albedo) => {
    const { accepted_edits } = await client.edit(scene.id, { op: 'material', object: objectName, albedo });
    await page.waitForFunction((n) => window.rebake.state().scene.accepted_edits >= n && window.rebake.state().fresh, accepted_edits);
  };
  await field.focus();
  await page.keyboard.press('End');
  await page.keyboard.type('7');
  await paint([0.3, 0.3, 0.6]);
  await page.keyboard.type('5');
  const value = await field.inputValue();
  check(value === '1.75', `what is typed outlives an update: 1.75 is, ${value} stands there`);
  await page.keyboard.press('Enter');
  await page.waitForFunction((n) => {
    const { min, max } = window.rebake.state().scene.objects.find((o) => o.name === n).bounds;
    return Math.abs((min[0] + max[0]) / 2 - 1.75) < 2e-3;
  }, objectName);
  check(true, 'and counts');
  await settled();
  await page.locator(`#objects [data-name="${objectName}"]`).focus();
  await paint([0.6, 0.3, 0.3]);
  check(await page.evaluate(() => document.activeElement.isSame === true), 'a row keeps its place and the focus');
  await settled();
  await undo(about, 3);
  // Onto the floor with many at once.
  const { asset } = await client.asset(new Blob([await client.objectMesh(scene.id, objectName)]));
  const things = Array.from({ length: 120 }, (_, k) => `box ${k}`);
  const at = (k) => [0.1, 0, 0, 0, 0, 0.1, 0, 0, 0, 0, 0.1, 0, 0.3 + 0.25 * (k % 12), 1.2, 0.3 + 0.3 * Math.floor(k / 12), 1];
  const edits = things.map((name, k) => ({ op: 'insert', asset, name, transform: at(k) }));
  const { accepted_edits } = await client.edit(scene.id, { edits });
  await page.waitForFunction((n) => window.rebake.state().scene.accepted_edits >= n && window.rebake.state().fresh, accepted_edits);
  await settled();
  const [count, ms] = await page.evaluate((names) => {
    // The best of three: others may have the processor meanwhile.
    const runs = [1, 2, 3].map(() => {
      const start = performance.now();
      const run = [window.rebake.stage.dropsOf(names).size, performance.now() - start];
      window.rebake.stage.settleBack();
      return run;
    });
    return runs.reduce((best, run) => (run[1] < best[1] ? run : best));
  }, things);
  check(count === things.length && ms < 2500, `${count} objects are put down in ${ms.toFixed(0)} ms`);
  const row = page.locator('#objects [role=treeitem]').first();
  await row.focus();
  const keys = await page.evaluate(async () => {
    const start = performance.now();
    for (const key of ['End', 'Home', 'End', 'Home']) document.activeElement.dispatchEvent(new KeyboardEvent('keydown', { key, bubbles: true, cancelable: true }));
    return performance.now() - start;
  });
  check(keys < 500 && (await state()).scene.accepted_edits === accepted_edits, `End and Home in their list take ${keys.toFixed(0)} ms and move nothing`);
  await undo(about);
}
