// Wires it all together: one scene at a time, followed live.

import { isOpen, makeWorker, streamInWorker, type FromWorker, type Job, type Point, type Rgb, type Scene } from 'rebake';
import { Matrix4 } from 'three';
import { client } from './api';
import { Editor } from './editor';
import { onDrop, onFile } from './files';
import { LightMap } from './lightmap';
import { attempting, banner, say } from './messages';
import { $, details, list, make, work } from './panels';
import { Plot } from './plot';
import { Relighting } from './relighting';
import { Stage, type Picked } from './stage';
import { Views } from './views';

const stage = new Stage($('canvas'));
const map = new LightMap();
const plot = new Plot($('plot'));
const worker = makeWorker();
const editor = new Editor(() => scene!, () => stage.view(), {
  before: () => {
    map.remember();
    stage.remember();
    before = new Set(scene?.objects.map((o) => o.name));
  },
  accepted: (job, label) => {
    say(`${label}: accepted`);
    told(job);
  },
  changed: buttons,
});

let scene: Scene | null = null;
let picked: Picked | null = null;
let version = 0;
let events = new AbortController();
let stopStream = () => {};
let jobs: Job[] = [];
/** Names of the objects before the last edit: the others have no light to compare with. */
let before = new Set<string>();
let shownMesh = '';
const assets = new Map<string, string>();

/** Runs something that may fail, and says how; what the service refused may rest on an old state of the scene. */
const attempt = (what: () => Promise<unknown>) => attempting(what, async () => scene && refresh());
const views = new Views(() => scene, stage, map, attempt);
const relighting = new Relighting(map);

// ---- scenes

async function listScenes(choose?: string): Promise<void> {
  const scenes = await client.scenes();
  const select = $<HTMLSelectElement>('scenes');
  select.replaceChildren(...scenes.map((s) => make('option', { value: s.id }, s.name || s.id)));
  if (scenes.length === 0) select.append(make('option', { value: '' }, 'none yet'));
  const wanted = choose ?? location.hash.slice(1);
  const found = scenes.find((s) => s.id === wanted) ?? scenes[0];
  if (found) await open(found.id);
  else leave();
}

function leave(): void {
  stopStream();
  events.abort();
  [scene, picked, jobs, shownMesh] = [null, null, [], ''];
  map.clear();
  stage.clear();
  plot.clear();
  editor.clear();
  before.clear();
  // Nothing of what is gone stays on the page.
  for (const about of ['mesh', 'stream']) delete $('numbers').dataset[about];
  stage.frameMs = 0;
  $('cameras').replaceChildren();
  $('welcome').hidden = false;
  say('Ready. Drop a .glb to begin.');
  panels();
}

async function open(id: string): Promise<void> {
  leave();
  say('Laying out its elements …');
  scene = await client.prepared(id);
  location.hash = id;
  $<HTMLSelectElement>('scenes').value = id;
  $('welcome').hidden = true;
  version = 0;
  await showMesh();
  const cameras = $<HTMLSelectElement>('cameras');
  const option = (value: string, text: string) => make('option', { value }, text);
  cameras.replaceChildren(option('', 'overview'), ...scene.cameras.map((c) => option(String(c.index), c.name)));
  cameras.value = scene.cameras.length ? '0' : '';
  useCamera();
  stopStream = streamInWorker(worker, client, id, streamed);
  jobs = await client.jobs(id);
  void listen(id);
  panels();
}

/** Fetches the mesh where its elements changed since. */
async function showMesh(): Promise<void> {
  const key = JSON.stringify(scene!.objects.map((o) => [o.name, o.elements, o.bounds, o.transform]));
  if (key === shownMesh) {
    stage.look(scene!);
    return;
  }
  const of = scene!.id;
  const file = await client.lightMap(of, { format: 'glb' });
  if (scene?.id !== of) return;
  shownMesh = key;
  await stage.show(file, scene, map);
  if (before.size) for (const o of scene.objects) if (!before.has(o.name)) map.forget(o.elements.first, o.elements.count);
  $('numbers').dataset['mesh'] = `${scene.elements.toLocaleString('en')} elements`;
}

/** The scene as it is now. */
async function refresh(): Promise<void> {
  if (!scene) return;
  const id = scene.id;
  const now = await client.scene(id);
  if (scene?.id !== id) return;
  scene = now;
  const gone = picked && ![...now.objects, ...now.lights].some((x) => x.name === picked!.name);
  if (gone) picked = null;
  await showMesh();
  stage.select(picked);
  panels();
  // The layers' weights may be new.
  views.refresh();
  settle();
  prepare();
}

// ---- what the service tells

async function listen(id: string): Promise<void> {
  events = new AbortController();
  const { signal } = events;
  for await (const { type, data } of client.events(id, signal)) {
    if (signal.aborted) return;
    if (type === 'job') told(data);
    else if (type === 'scene' && data.what === 'deleted') void attempt(() => listScenes());
    else if (type === 'scene') void attempt(refresh);
    else if (type === 'reset') void attempt(async () => ((jobs = await client.jobs(id)), refresh()));
    else if (type === 'snapshot' && scene) {
      scene.estimated_rmse = data.estimated_rmse;
      if (data.elements_version > scene.elements_version) void attempt(refresh);
    }
  }
}

function told(job: Job): void {
  const at = jobs.findIndex((j) => j.id === job.id);
  // An answer to a request may come after an event that is newer than it.
  const rank = { queued: 0, paused: 0, running: 1, succeeded: 2, failed: 2, canceled: 2 };
  if (at < 0) jobs.unshift(job);
  else if (rank[job.state] >= rank[jobs[at]!.state] || (job.state === 'paused' && rank[jobs[at]!.state] < 2)) jobs[at] = job;
  const { estimated_rmse, elapsed_ms } = job.progress;
  if (typeof estimated_rmse === 'number') plot.add(job.id, elapsed_ms / 1000, estimated_rmse);
  if (job.state === 'failed') banner(`The job failed: ${job.error}`);
  if (scene && rank[job.state] === 2) scene.estimated_rmse = estimated_rmse ?? scene.estimated_rmse;
  panelsOfWork();
  // Layers and their weights are those of the newest version.
  if (scene && rank[job.state] === 2) void attempt(refresh);
  settle();
}

/** Once the service's map has all that was relit, it counts and not what the page worked out. */
function settle(): void {
  const isOver = jobs.every((job) => !isOpen(job) && (job.progress.version ?? 0) <= version);
  if (isOver && !dragged) relighting.rest();
}

let isLost = false;

/** After a lost connection: what happened meanwhile. The light map's stream resumes by itself. */
async function caughtUp(): Promise<void> {
  if (!scene) return;
  events.abort();
  jobs = await client.jobs(scene.id);
  void listen(scene.id);
  await refresh();
}

function streamed(data: FromWorker): void {
  switch (data.type) {
    case 'snapshot': {
      version = data.version;
      const grown = map.snapshot(data.frames);
      // The arrays were replaced: the mesh has to look into the new ones.
      if (grown && scene) {
        shownMesh = '';
        void attempt(refresh);
      }
      const rate = data.elements > 10_000 ? `, decoded at ${Math.round(data.elements / data.ms / 1000)} M elements/s` : '';
      $('numbers').dataset['stream'] = `version ${version}: ${data.elements.toLocaleString('en')} values${rate}`;
      settle();
      views.refresh();
      stage.invalidate();
      break;
    }
    case 'offline':
      isLost = true;
      banner('The connection is lost. Trying again…', true);
      say('Not connected');
      break;
    case 'online':
      if (isLost) void attempt(caughtUp);
      isLost = false;
      banner(null);
      say('Connected');
      break;
    case 'gone':
      say('This scene is gone');
      banner('The service no longer has this scene: it was deleted, or the service was started anew. Upload it again.');
      void listScenes().catch(() => {});
      break;
    case 'failed':
      banner(data.why);
  }
}

function useCamera(): void {
  const camera = scene?.cameras[Number($<HTMLSelectElement>('cameras').value || -1)];
  if (camera) stage.use(camera);
  else stage.overview();
}

// ---- editing

function choose(next: Picked | null): void {
  picked = next;
  stage.select(picked);
  panels();
  prepare();
}

const object = () => scene?.objects.find((o) => picked?.kind === 'object' && o.name === picked.name);
const light = () =>
  scene?.lights.find((l) => (picked?.kind === 'light' ? l.name === picked.name : l.object === picked?.name));

function remove(): void {
  const [o, l] = [object(), light()];
  if (o) void attempt(() => editor.remove(o, stage.group(o.name)!));
  else if (l) void attempt(() => editor.removeLight(l));
}

/** Has the layer of the selected light at hand, for its sliders. */
function prepare(): void {
  const [at, l] = [scene, light()];
  if (at && l) void attempt(() => relighting.prepare(at, l));
}

let dragged: { from: ReturnType<typeof light>; next: [Rgb, number] | null; busy: boolean } | null = null;

/** Sends the newest position of a slider, one request at a time: what is in between is skipped. */
function relight(color: Rgb, intensity: number, done: boolean): void {
  dragged ??= { from: structuredClone(light()), next: null, busy: false };
  if (scene && dragged.from && views.isMap && relighting.show(scene, dragged.from, version, color, intensity)) stage.invalidate();
  const drag = dragged;
  drag.next = [color, intensity];
  if (done) dragged = null;
  if (drag.busy || !drag.from) return;
  drag.busy = true;
  void attempt(async () => {
    try {
      while (drag.next) {
        const [c, i] = drag.next;
        drag.next = null;
        await editor.relight(drag.from!, c, i);
      }
    } finally {
      drag.busy = false;
    }
  });
}

stage.onPick = choose;
stage.onCamera = () => scene && views.isPicture && views.refresh();
stage.onMoved = (_, delta) => move(delta);
function move(delta: Matrix4): void {
  const [o, l] = [object(), light()];
  if (o) void attempt(() => editor.move(o, delta));
  else if (l?.position) {
    const e = delta.elements;
    const [x, y, z] = l.position;
    void attempt(() => editor.moveLight(l, [x + e[12]!, y + e[13]!, z + e[14]!] as Point));
  }
}

async function upload(file: File): Promise<void> {
  say(`Uploading ${file.name}…`);
  const created = await client.upload(file, { name: file.name.replace(/\.glb$/i, '') });
  if (created.warnings.length) banner(created.warnings.join('; '), true);
  await listScenes(created.id);
}

async function addAsset(file: File): Promise<void> {
  const name = file.name.replace(/\.glb$/i, '');
  assets.set(name, (await client.asset(file)).asset);
  say(`${name} is in the library: click it to put it into the scene`);
  panels();
}

// ---- the page

function buttons(): void {
  for (const [id, label] of [['undo', editor.canUndo], ['redo', editor.canRedo]] as const) {
    $<HTMLButtonElement>(id).disabled = !label;
    $(id).title = label ? `${id}: ${label}` : `nothing to ${id}`;
  }
}

function panels(): void {
  const chosen = (kind: string) => (picked?.kind === kind ? picked.name : null);
  list('objects', scene?.objects.map((o) => o.name) ?? [], chosen('object'), (name) => choose({ kind: 'object', name }));
  list('lights', scene?.lights.map((l) => l.name) ?? [], chosen('light'), (name) => choose({ kind: 'light', name }));
  list('assets', [...assets.keys()], null, (name) => {
    if (scene) void attempt(() => editor.insert(assets.get(name)!, name, stage.view().target));
  });
  views.offer(scene);
  details(scene, picked, {
    remove,
    relight,
    frame: () => stage.frameSelected(),
    move: (by) => move(new Matrix4().makeTranslation(...by)),
    paint: (albedo, done) => {
      const o = object();
      if (!o) return;
      stage.paint(o.name, albedo);
      if (done) void attempt(() => editor.paint(o, albedo));
    },
  });
  $<HTMLButtonElement>('add-light').disabled = !scene;
  panelsOfWork();
}

function panelsOfWork(): void {
  work(jobs, scene?.estimated_rmse ?? null, (job) => void attempt(() => client.cancel(job.id)));
}

function keys(event: KeyboardEvent): void {
  const target = event.target;
  // Lists of choices and numbers take letters and digits themselves; sliders and boxes do not.
  if (target instanceof HTMLSelectElement || (target instanceof HTMLInputElement && target.type === 'number')) return;
  const control = event.ctrlKey || event.metaKey;
  const choices = [...$<HTMLSelectElement>('view').options].map((o) => o.value);
  const key = event.key.toLowerCase();
  if (control && key === 'z') void attempt(() => (event.shiftKey ? editor.redo() : editor.undo()));
  else if (control && key === 'y') void attempt(() => editor.redo());
  else if (control) return;
  else if (key === 'delete') remove();
  else if (key === 'escape') choose(null);
  else if (key === 's') views.split(!stage.split);
  else if (key === 'f') stage.frameSelected();
  else if (key === '[' || key === ']') views.expose(views.exposure + (key === '[' ? -0.5 : 0.5));
  else if (choices[Number(key) - 1]) views.set(choices[Number(key) - 1]!);
  else return;
  event.preventDefault();
}

onFile('file', (file) => attempt(() => upload(file)));
onFile('asset-file', (file) => attempt(() => addAsset(file)));
$('upload').addEventListener('click', () => $('file').click());
$('add-asset').addEventListener('click', () => $('asset-file').click());
$('add-light').addEventListener('click', () => {
  const size = Math.max(...scene!.objects.flatMap((o) => o.bounds.max.map((x, k) => x - o.bounds.min[k]!)), 1);
  const [x, y, z] = stage.view().target;
  void attempt(async () => choose({ kind: 'light', name: await editor.addLight([x, y + size / 10, z], size * size) }));
});
$('undo').addEventListener('click', () => void attempt(() => editor.undo()));
$('redo').addEventListener('click', () => void attempt(() => editor.redo()));
$('scenes').addEventListener('change', ({ target }) => void attempt(() => open((target as HTMLSelectElement).value)));
$('view').addEventListener('change', ({ target }) => views.set((target as HTMLSelectElement).value));
$('split').addEventListener('change', ({ target }) => views.split((target as HTMLInputElement).checked));
$('cameras').addEventListener('change', useCamera);
$('exposure').addEventListener('input', ({ target }) => views.expose(Number((target as HTMLInputElement).value)));
document.addEventListener('keydown', keys);
onDrop((file) => attempt(() => upload(file)));
setInterval(() => {
  const { mesh, stream } = $('numbers').dataset;
  $('numbers').textContent = [mesh, stream, stage.frameMs ? `frame ${stage.frameMs.toFixed(0)} ms` : ''].filter(Boolean).join(' · ');
}, 500);
// For the console and for tests.
Object.assign(window, { rebake: { stage, map, relighting, client, state: () => ({ scene, version, jobs, exposure: views.exposure, view: views.current }) } });

buttons();
panels();
void attempt(() => listScenes());
