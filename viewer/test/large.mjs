// Frame time and decode rate of the page on a scene of about a million elements, in a real browser:
//
//   rebake serve --listen 127.0.0.1:7878 &
//   node viewer/test/large.mjs http://127.0.0.1:7878 [elements] [screenshot.png]
//
// Uploads a generated room at the spacing that gives so many elements, lights it coarsely, opens it, turns the camera,
// relights the lamp (every value changes at once) and prints what each took. For CHROMIUM and PAGE_DIR see launch.mjs.

import { launch } from './launch.mjs';

const [base, wanted = '1000000', shot] = process.argv.slice(2);

/** A room of 6 × 3 × 5 m with boxes on its floor and a lamp, as binary glTF. */
function room() {
  const [positions, normals, indices, nodes, meshes, accessors] = [[], [], [], [], [], []];
  const part = (values, type, componentType, bufferView, offset, bounds = {}) =>
    accessors.push({ bufferView, byteOffset: offset, componentType, count: values, type, ...bounds }) - 1;
  const box = (name, low, high, material, turned = 1) => {
    const [first, from] = [positions.length / 3, indices.length];
    for (const axis of [0, 1, 2]) {
      for (const side of [0, 1]) {
        const corner = positions.length / 3 - first;
        for (const [u, v] of [[0, 0], [1, 0], [1, 1], [0, 1]]) {
          const point = [0, 0, 0];
          point[axis] = side ? high[axis] : low[axis];
          point[(axis + 1) % 3] = u ? high[(axis + 1) % 3] : low[(axis + 1) % 3];
          point[(axis + 2) % 3] = v ? high[(axis + 2) % 3] : low[(axis + 2) % 3];
          positions.push(...point);
          normals.push(...[0, 1, 2].map((k) => (k === axis ? (side ? turned : -turned) : 0)));
        }
        const outward = (side === 1) === (turned === 1);
        indices.push(...(outward ? [0, 1, 2, 0, 2, 3] : [0, 2, 1, 0, 3, 2]).map((k) => corner + k));
      }
    }
    const bounds = { min: low, max: high };
    const primitive = {
      attributes: { POSITION: part(24, 'VEC3', 5126, 0, 12 * first, bounds), NORMAL: part(24, 'VEC3', 5126, 1, 12 * first) },
      indices: part(36, 'SCALAR', 5125, 2, 4 * from),
      material,
    };
    nodes.push({ name, mesh: meshes.push({ primitives: [primitive] }) - 1 });
  };
  box('room', [0, 0, 0], [6, 3, 5], 0, -1);
  for (let k = 0; k < 12; k++) {
    const [x, z] = [0.6 + (k % 4) * 1.4, 0.5 + Math.floor(k / 4) * 1.5];
    box(`box-${k + 1}`, [x, 0, z], [x + 0.6, 0.4 + (k % 3) * 0.3, z + 0.5], 1 + (k % 2));
  }
  box('lamp', [2.6, 2.9, 2.1], [3.4, 2.95, 2.9], 3);
  const diffuse = (color) => ({ pbrMetallicRoughness: { baseColorFactor: [...color, 1], metallicFactor: 0 } });
  const lamp = { ...diffuse([0, 0, 0]), emissiveFactor: [1, 0.9, 0.75], extensions: { KHR_materials_emissive_strength: { emissiveStrength: 12 } } };
  const parts = [new Float32Array(positions), new Float32Array(normals), new Uint32Array(indices)].map((a) => Buffer.from(a.buffer));
  let offset = 0;
  const bufferViews = parts.map((bytes) => ({ buffer: 0, byteOffset: (offset += bytes.length) - bytes.length, byteLength: bytes.length }));
  const document = {
    asset: { version: '2.0' }, scene: 0, scenes: [{ nodes: nodes.map((_, k) => k) }], nodes, meshes, accessors, bufferViews,
    buffers: [{ byteLength: offset }], extensionsUsed: ['KHR_materials_emissive_strength'],
    materials: [diffuse([0.75, 0.72, 0.68]), diffuse([0.6, 0.2, 0.15]), diffuse([0.2, 0.35, 0.6]), lamp],
  };
  const text = Buffer.from(JSON.stringify(document));
  const json = Buffer.concat([text, Buffer.alloc(-text.length & 3, ' ')]);
  const chunk = (bytes, kind) => {
    const head = Buffer.alloc(8);
    head.writeUInt32LE(bytes.length);
    head.write(kind, 4, 'latin1');
    return Buffer.concat([head, bytes]);
  };
  const chunks = Buffer.concat([chunk(json, 'JSON'), chunk(Buffer.concat(parts), 'BIN\0')]);
  const head = Buffer.alloc(12);
  head.write('glTF', 'latin1');
  head.writeUInt32LE(2, 4);
  head.writeUInt32LE(12 + chunks.length, 8);
  return Buffer.concat([head, chunks]);
}

async function json(path, init) {
  const answer = await fetch(`${base}/v1/${path}`, init);
  const body = await answer.json();
  if (!answer.ok) throw new Error(`${path}: ${body.title}: ${body.detail}`);
  return body;
}

/** Until a job is over, by its events: the connection ends with it. */
async function ended(id) {
  await (await fetch(`${base}/v1/jobs/${id}/events`)).text();
  const job = await json(`jobs/${id}`);
  if (job.state !== 'succeeded') throw new Error(`job ${id}: ${job.state}: ${job.error}`);
}

const upload = (query) => json(`scenes?${query}`, { method: 'POST', body: room(), headers: { 'content-type': 'model/gltf-binary' } });
const median = (values) => values.toSorted((a, b) => a - b)[values.length >> 1];

// Elements go with 1 / spacing²: one coarse upload tells the factor.
const coarse = await upload('name=coarse&spacing=0.1&bake=false');
await json(`scenes/${coarse.id}`, { method: 'DELETE' }).catch(() => {});
const spacing = 0.1 * Math.sqrt(coarse.elements / Number(wanted));
const scene = await upload(`name=large&spacing=${spacing.toFixed(5)}&samples_per_element=1&layers=each`);
console.log(`${scene.elements} elements, spacing ${(1000 * spacing).toFixed(1)} mm`);
await ended(scene.current_job);

const { page, close } = await launch(base, { width: 1280, height: 720 });
try {
  page.setDefaultTimeout(300_000);
  const opened = performance.now();
  await page.goto(`${base}/#${scene.id}`);
  await page.waitForFunction((n) => {
    const { scene, version } = window.rebake.state();
    return scene?.elements === n && version >= scene.version && window.rebake.map.elements === n;
  }, scene.elements, { polling: 50 });
  await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
  console.log(`open to first lit frame: ${((performance.now() - opened) / 1000).toFixed(1)} s`);
  await page.waitForFunction(() => document.getElementById('numbers').textContent.includes('M elements/s'), null, { polling: 50 });
  console.log(`page says: ${await page.locator('#numbers').textContent()}`);

  const turning = await page.evaluate(async () => {
    const { stage } = window.rebake;
    const frame = () => new Promise((done) => requestAnimationFrame(done));
    const times = [];
    let last = await frame();
    for (let k = 0; k < 30; k++) {
      const { camera, orbit } = stage;
      camera.position.sub(orbit.target).applyAxisAngle(camera.up, 0.05).add(orbit.target);
      orbit.update();
      stage.invalidate();
      const now = await frame();
      times.push(now - last);
      last = now;
    }
    return times.slice(2);
  });
  const size = await page.evaluate(() => window.rebake.stage.view());
  console.log(`turning, ${size.width} x ${size.height} pixels: median ${median(turning).toFixed(0)} ms a frame, worst ${Math.max(...turning).toFixed(0)} ms`);

  // Every value changes: one snapshot of the whole map, decoded by the worker, copied and uploaded by the page.
  const relit = await page.evaluate(async () => {
    const { client, map, stage, state } = window.rebake;
    const { scene, version } = state();
    const light = scene.lights[0];
    let [applied, most, last, arrived] = [0, 0, performance.now(), 0];
    const snapshot = map.snapshot.bind(map);
    map.snapshot = (frames) => {
      const start = performance.now();
      const grown = snapshot(frames);
      applied = performance.now() - start;
      arrived = performance.now();
      return grown;
    };
    const start = performance.now();
    await client.edit(scene.id, { op: 'relight', lights: [{ light: light.name, intensity: light.intensity * 0.5 }] }, { focus: stage.view() });
    while (state().version === version || performance.now() < arrived + 300) {
      const now = await new Promise((done) => requestAnimationFrame(done));
      most = Math.max(most, now - last);
      last = now;
    }
    map.snapshot = snapshot;
    return { applied, most, seconds: (arrived - start) / 1000 };
  });
  console.log(`relight of all values: there after ${relit.seconds.toFixed(2)} s, ${relit.applied.toFixed(0)} ms on the page's thread, longest gap between frames ${relit.most.toFixed(0)} ms`);
  await page.waitForFunction(() => document.getElementById('numbers').textContent.includes('M elements/s'));
  console.log(`page says: ${await page.locator('#numbers').textContent()}`);
  if (shot) await page.screenshot({ path: shot });
} finally {
  await close();
  await json(`scenes/${scene.id}`, { method: 'DELETE' }).catch(() => {});
}
