// What a level artist does all day: place, copy, light, take back, and not lose work.

import { drag, updates } from './hands.mjs';
import { close, extent, found, middle, undo } from './helpers.mjs';
import { patch } from './pictures.mjs';

export async function checkTools(about) {
  await numbers(about);
  await copies(about);
  await several(about);
  await drops(about);
  await skies(about);
  await lamps(about);
  await drag(about);
  await updates(about);
  await lists(about);
  await away(about);
  await late(about);
  await others(about);
  await history(about);
}

/** Types a number into a field, and waits until an object is otherwise. */
async function type({ page, objectName, settled, state }, label, value) {
  const before = JSON.stringify((await found({ state }, objectName)).transform);
  await page.getByLabel(label).fill(String(value));
  await page.keyboard.press('Enter');
  await page.waitForFunction(([n, t]) => JSON.stringify(window.rebake.state().scene.objects.find((o) => o.name === n).transform) !== t, [objectName, before]);
  await settled();
}

async function numbers(about) {
  const { page, check, choose, objectName, project } = about;
  await choose('objects', objectName);
  const was = await found(about, objectName);
  await type(about, 'Rotation y, degrees', 90);
  const turned = await found(about, objectName);
  check(close(extent(turned)[0], extent(was)[2]) && close(middle(turned)[0], middle(was)[0]), 'an object is turned by numbers, about its middle');
  await type(about, 'Scale y, factor', 1.5);
  const grown = await found(about, objectName);
  check(close(extent(grown)[1], 1.5 * extent(was)[1]) && close(middle(grown)[2], middle(was)[2]), 'and scaled');
  await undo(about, 2);
  check((await found(about, objectName)).transform.every((x, k) => close(x, was.transform[k], 1e-6)), 'and both are taken back');
  await page.locator('#canvas').focus();
  await page.keyboard.press('f');
  const at = await project(middle(was));
  check(close(at[0], 0.5, 0.02) && close(at[1], 0.5, 0.02), 'F turns to the selected');
  const up = await page.evaluate(() => window.rebake.stage.view().up);
  check(up[0] === 0 && up[1] === 1 && up[2] === 0, 'the horizon is level');
  await about.shot('20-framed');
  await page.selectOption('#cameras', '');
  await page.selectOption('#cameras', '0');
}

async function copies(about) {
  const { page, check, settled, objectName, state } = about;
  await page.locator('#canvas').focus();
  await page.keyboard.press('Control+d');
  const copy = `${objectName}-2`;
  await page.waitForFunction((n) => window.rebake.state().scene.objects.some((o) => o.name === n), copy);
  const [one, two] = [await found(about, objectName), await found(about, copy)];
  check(extent(one).every((x, k) => close(x, extent(two)[k])) && two.bounds.min[0] > one.bounds.max[0], 'a copy stands beside it');
  await page.waitForFunction((n) => document.querySelector('#details strong')?.textContent === n, copy);
  await page.locator('#canvas').focus();
  await settled();
  await page.keyboard.press('End');
  await page.waitForFunction((n) => Math.abs(window.rebake.state().scene.objects.find((o) => o.name === n).bounds.min[1]) < 1e-3, copy);
  check(true, 'and is put onto the floor by a key');
  const hide = page.locator('#details button', { hasText: 'Hide' });
  await hide.click();
  await page.waitForFunction((n) => window.rebake.state().scene.objects.find((o) => o.name === n).hidden, copy);
  await settled();
  check((await page.locator(`#objects [data-name="${copy}"]`).textContent()).includes('hidden'), 'what is hidden says so in the list');
  await about.shot('21-hidden');
  await undo(about, 3);
  check(!(await state()).scene.objects.some((o) => o.name === copy), 'all of it is taken back');
}

async function lamps(about) {
  const { page, check, settled, state, canvas, shot } = about;
  const mean = () => page.evaluate(() => window.rebake.map.meanOf(window.rebake.state().scene.objects));
  const before = await mean();
  for (const kind of ['point', 'spot', 'directional', 'area', 'sky']) {
    const { scene } = await state();
    await page.selectOption('#add-light', kind);
    await page.waitForFunction((n) => window.rebake.state().scene.lights.length > n, scene.lights.length);
    await settled();
    const ratio = (await mean()) / before;
    check(ratio >= 0.99 && ratio < 4, `a new lamp (${kind}) whites out nothing: the room is ${ratio.toFixed(2)} times as bright`);
    if (kind === 'spot') {
      await page.getByLabel('Colour, hexadecimal sRGB').fill('ff8000');
      await page.keyboard.press('Enter');
      await page.waitForFunction(() => Math.abs(window.rebake.state().scene.lights.find((l) => l.name === 'spot-1').color[1] - 0.2158) < 1e-3);
      check(true, 'its colour is typed as sRGB');
      const field = page.getByRole('spinbutton', { name: 'Intensity, cd' });
      await field.fill('12');
      await page.keyboard.press('Enter');
      await page.waitForFunction(() => Math.abs(window.rebake.state().scene.lights.find((l) => l.name === 'spot-1').intensity - 12) < 1e-3);
      check(true, 'and its intensity as a number');
      await settled();
      await shot('22-spot');
      await undo(about, 2);
    }
    await undo(about);
  }
  check(patch(await canvas(), [0.5, 0.85]) > 0, 'and all are taken back');
}

async function several(about) {
  const { page, check, choose, settled, objectName, state, shot } = about;
  const [first, second] = [objectName, 'lamp'];
  await choose('objects', first);
  await choose('objects', second, ['Control']);
  check((await page.locator('#details strong').textContent()) === '2 objects', 'several are selected with Ctrl');
  await choose('objects', 'room', ['Shift']);
  const names = (await state()).selected.map(({ name }) => name);
  check(names.length === 3 && names.at(-1) === 'room', 'and all between with Shift');
  await choose('objects', first);
  await choose('objects', second, ['Control']);
  const was = await Promise.all([first, second].map((name) => found(about, name)));
  const { scene } = await state();
  await page.getByLabel('Move by x, metres').fill('0.3');
  await page.keyboard.press('Enter');
  await page.waitForFunction((n) => window.rebake.state().scene.accepted_edits > n && window.rebake.state().fresh, scene.accepted_edits);
  const now = await Promise.all([first, second].map((name) => found(about, name)));
  check(now.every((one, k) => close(one.bounds.min[0] - was[k].bounds.min[0], 0.3)) && (await state()).scene.accepted_edits === scene.accepted_edits + 1, 'they are moved by one edit');
  await page.locator('#canvas').focus();
  await page.keyboard.press('Control+d');
  const copies = [first, second].map((name) => `${name}-2`);
  await page.waitForFunction((all) => all.every((n) => window.rebake.state().scene.objects.some((o) => o.name === n)), copies);
  await page.waitForFunction(() => window.rebake.state().selected.map(({ name }) => name).join() === 'cupboard-2,lamp-2');
  await shot('20b-several');
  await page.locator('#canvas').focus();
  await page.keyboard.press('Delete');
  await page.waitForFunction((all) => !all.some((n) => window.rebake.state().scene.objects.some((o) => o.name === n)), copies);
  check((await state()).selected.length === 0, 'copied, and removed');
  await undo(about, 3);
  check((await found(about, second)).transform.every((x, k) => close(x, was[1].transform[k], 1e-6)), 'and each is taken back at once');
  await settled();
}

/** A file, and a thing of the library, dropped onto the scene. */
async function drops(about) {
  const { page, check, settled, objectName, client, scene, project, state, shot } = about;
  const file = Buffer.from(await client.objectMesh(scene.id, objectName)).toString('base64');
  const box = await page.locator('#canvas').boundingBox();
  const point = [3, 0, 2.6];
  const [u, v] = await project(point);
  await page.evaluate(([bytes, x, y]) => {
    const dataTransfer = new DataTransfer();
    dataTransfer.items.add(new File([Uint8Array.from(atob(bytes), (c) => c.charCodeAt(0))], 'box.glb'));
    const init = { bubbles: true, cancelable: true, clientX: x, clientY: y, dataTransfer };
    for (const type of ['dragover', 'drop']) document.getElementById('canvas').dispatchEvent(new DragEvent(type, init));
  }, [file, box.x + u * box.width, box.y + v * box.height]);
  const there = (name) => page.waitForFunction((n) => window.rebake.state().scene.objects.some((o) => o.name === n) && window.rebake.state().fresh, name);
  await there('box');
  const one = await found(about, 'box');
  const at = middle(one);
  check(close(one.bounds.min[1], 0, 0.02) && close(at[0], point[0], 0.05) && close(at[2], point[2], 0.05), 'a file that is dropped stands on the surface under the pointer');
  await settled();
  // Onto the wall at the back, in steps of the grid.
  const spot = await project([2.6, 1.6, 0]);
  await page.selectOption('#grid', '0.5');
  await page.locator('#assets [data-name="box"]').dragTo(page.locator('#canvas'), { targetPosition: { x: spot[0] * box.width, y: spot[1] * box.height } });
  await there('box-2');
  const { bounds } = await found(about, 'box-2');
  await page.selectOption('#grid', '0');
  check(close(bounds.min[2], 0, 0.02) && close(middle({ bounds })[0], 2.5, 0.01) && close(middle({ bounds })[1], 1.5, 0.01), 'a thing of the library that is dragged there hangs on the wall, in step with the grid');
  await settled();
  await shot('20c-dropped');
  await undo(about, 2);
  check(!(await state()).scene.objects.some((o) => o.name.startsWith('box')), 'and both are taken back');
}

/** A picture of the sky, dropped onto the scene; the library has it, after a reload too. */
async function skies(about) {
  const { page, check, settled, state } = about;
  await page.evaluate(() => {
    // Radiance, one everywhere: eight texels across, four down.
    const head = new TextEncoder().encode('#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n');
    const dataTransfer = new DataTransfer();
    dataTransfer.items.add(new File([head, new Uint8Array(Array(32).fill([128, 128, 128, 129]).flat())], 'noon.hdr'));
    const init = { bubbles: true, cancelable: true, clientX: 600, clientY: 300, dataTransfer };
    for (const type of ['dragover', 'drop']) document.getElementById('canvas').dispatchEvent(new DragEvent(type, init));
  });
  await page.waitForFunction(() => window.rebake.state().scene.lights.some((l) => l.kind === 'environment') && window.rebake.state().fresh);
  await settled();
  check((await page.locator('#assets [data-name="noon"]').textContent()).includes('sky'), 'a picture of the sky that is dropped lights the scene, and is in the library as one');
  await undo(about);
  check(!(await state()).scene.lights.some((l) => l.kind === 'environment'), 'and is taken back');
  await page.evaluate(() => window.rebake.client.assets()).then((assets) => check(assets.some((one) => one.picture) && assets.some((one) => one.bounds && one.name), 'the service tells what can be inserted, where it is and how it is called'));
}

async function lists(about) {
  const { page, check, objectName, state } = about;
  const { scene } = await state();
  // As many as a level has: only the lists are told.
  const many = async (route) => {
    const answer = await route.fetch();
    const body = await answer.json();
    for (let k = 0; k < 500; k++) body.objects.push({ ...body.objects[0], name: `thing ${k}`, hidden: true, elements: { first: 0, count: 0 } });
    for (let k = 0; k < 20; k++) body.lights.push({ ...body.lights[0], name: `lamp ${k}`, object: null });
    await route.fulfill({ response: answer, json: body });
  };
  const path = new RegExp(`/v1/scenes/${scene.id}$`);
  await page.route(path, many);
  await page.reload();
  const rows = (count) => page.waitForFunction((n) => document.querySelectorAll('#objects [role=treeitem]').length === n, count);
  await rows(scene.objects.length + 1);
  const group = page.locator('#objects [data-key="group thing"]');
  check((await group.textContent()).includes('thing × 500'), 'objects that are called alike are one row of the list');
  await group.locator('.twist').click();
  await rows(scene.objects.length + 501);
  const stops = await page.evaluate(() => ['objects', 'lights'].map((id) => document.querySelectorAll(`#${id} [tabindex="0"]`).length));
  check(stops.join() === '1,1', 'each list is one stop of the tab key');
  const view = page.viewportSize();
  for (const id of ['objects', 'lights', 'add-light', 'add-asset']) {
    const box = await page.locator(`#${id}`).boundingBox();
    check(box.y + box.height <= view.height && box.height > 20, `${id} is in view with 500 objects and 20 lights`);
  }
  await about.shot('23-many');
  await page.locator('#search').fill('thing 49');
  await rows(11);
  check((await page.locator('#object-count').textContent()) === `11 of ${500 + scene.objects.length}`, 'a search leaves what fits');
  await page.locator('#search').fill('');
  await page.keyboard.press('Tab');
  await page.keyboard.press('End');
  await page.keyboard.press('Home');
  await page.keyboard.press('ArrowDown');
  await page.keyboard.press('Enter');
  check((await page.evaluate(() => document.activeElement.dataset.name)) === scene.objects[1].name, 'arrows go along a list');
  check((await page.locator('#details strong').textContent()) === scene.objects[1].name, 'and Enter selects');
  await page.keyboard.press('Shift+ArrowUp');
  check((await page.locator('#details strong').textContent()) === '2 objects', 'and Shift goes on from there');
  await page.keyboard.press('End');
  await group.focus();
  await page.keyboard.press('ArrowLeft');
  await rows(scene.objects.length + 1);
  await group.focus();
  await page.keyboard.press('Enter');
  check((await page.locator('#details strong').textContent()) === '500 objects', 'a group is closed and selected by the keyboard');
  await page.unroute(path, many);
  await page.reload();
  await page.waitForFunction((n) => window.rebake.state().scene?.objects.length === n && window.rebake.state().version > 0, scene.objects.length);
  await page.locator('#exposure').fill('-0.5');
  await about.choose('objects', objectName);
}

async function away(about) {
  const { page, check, settled, objectName } = about;
  await about.choose('objects', objectName);
  const lost = (route) => route.abort();
  await page.route('**/edits', lost);
  await page.locator('#details button', { hasText: 'Hide' }).click();
  await page.locator('#waiting').waitFor({ state: 'visible' });
  check((await page.locator('#waiting-what').textContent()).includes(`hide ${objectName}`), 'an edit waits while the service is away, and says so');
  await about.shot('24-waiting');
  await page.unroute('**/edits', lost);
  await page.waitForFunction((n) => window.rebake.state().scene.objects.find((o) => o.name === n).hidden, objectName);
  await page.locator('#waiting').waitFor({ state: 'hidden' });
  check(true, 'and is made when it is back');
  await settled();
  await page.route('**/edits', lost);
  await page.locator('#details button', { hasText: 'Show' }).click();
  await page.locator('#waiting-drop').click();
  await page.waitForFunction(() => document.getElementById('banner').textContent.includes('was dropped'));
  await page.unroute('**/edits', lost);
  check((await found(about, objectName)).hidden, 'or is dropped, with a word');
  await undo(about);
}

/** Two at one scene: an edit for what is no more is not made, and says so. */
async function others(about) {
  const { page, check, settled, objectName, client, scene, state } = about;
  await about.choose('objects', objectName);
  let release;
  const held = new Promise((done) => (release = done));
  const path = new RegExp(`/v1/scenes/${scene.id}$`);
  const hold = async (route) => {
    await held;
    await route.continue();
  };
  await page.route(path, hold);
  await client.edit(scene.id, { op: 'material', object: objectName, albedo: [0.6, 0.1, 0.1] });
  await page.locator('#details button', { hasText: 'Hide' }).click();
  await page.waitForFunction(() => document.getElementById('status').textContent.includes('not made'));
  release();
  await page.waitForFunction(() => document.getElementById('banner').textContent.includes('Somebody else has changed the scene'));
  const now = await found(about, objectName);
  check(!now.hidden && close(now.albedo[0], 0.6), 'an edit that meets another one is shown, and overwrites nothing');
  await page.unroute(path, hold);
  await about.shot('25-conflict');
  await page.locator('#banner button', { hasText: 'Do it all the same' }).click();
  await page.waitForFunction((n) => window.rebake.state().scene.objects.find((o) => o.name === n).hidden, objectName);
  check((await state()).scene.accepted_edits >= 2, 'and is made when it is wanted all the same');
  await settled();
}

/** An old answer that comes after a newer one does not count. */
async function late(about) {
  const { page, check, settled, objectName, client, scene } = about;
  let answers = 0;
  let another;
  const newer = new Promise((done) => (another = done));
  const hold = async (route) => {
    const answer = await route.fetch();
    // Where the page asks for one at a time, none comes before the old one.
    if (++answers === 1) await Promise.race([newer, new Promise((done) => setTimeout(done, 1000))]);
    await route.fulfill({ response: answer });
    if (answers > 1) another();
  };
  const paint = (albedo) => client.edit(scene.id, { op: 'material', object: objectName, albedo });
  const path = new RegExp(`/v1/scenes/${scene.id}$`);
  await page.route(path, hold);
  const [first, last] = [await paint([0.2, 0.5, 0.2]), await paint([0.2, 0.4, 0.6])];
  await Promise.all([first, last].map(({ id }) => client.finished(id)));
  await page.waitForFunction((n) => window.rebake.state().scene.accepted_edits >= n, last.accepted_edits);
  await settled();
  const shown = await page.evaluate((n) => window.rebake.state().scene.objects.find((o) => o.name === n).albedo[2], objectName);
  check(close(shown, 0.6), 'an old answer that comes late does not count');
  await page.unroute(path, hold);
  await undo(about, 2);
}

async function history(about) {
  const { page, check, objectName, settled } = about;
  const first = await page.locator('#history li').first().textContent();
  check(first === `hide ${objectName}`, 'the history has the newest edit on top');
  await page.reload();
  await page.waitForFunction(() => window.rebake.state().scene && window.rebake.state().version > 0);
  await page.waitForFunction((text) => document.querySelector('#history li')?.textContent === text, first);
  check((await page.locator('#undo').getAttribute('title')) === `undo: hide ${objectName}`, 'and survives a reload');
  await settled();
  await undo(about, 2);
  const now = await found(about, objectName);
  check(!now.hidden && now.albedo[0] < 0.4, 'as undo does');
  await page.locator('#redo').click();
  await page.waitForFunction((n) => window.rebake.state().scene.objects.find((o) => o.name === n).albedo[0] > 0.5, objectName);
  await settled();
  check((await page.locator('#history li').first().textContent()).includes('undone'), 'what is undone says so');
  await about.shot('26-history');
  await undo(about);
}
