// Wires it all together: one scene at a time, followed live.

import { isOpen, makeWorker, streamInWorker, type FromWorker, type Job, type Light, type Rgb, type Scene, type Upload } from 'rebake';
import { client } from './api';
import { Commands } from './commands';
import { details } from './details';
import { $ } from './dom';
import { Editor } from './editor';
import { onDrop, onFile } from './files';
import { showHistory } from './history';
import { watchDialogs, watchKeys } from './keys';
import type { LampKind } from './lamps';
import { Library } from './library';
import { LightMap } from './lightmap';
import { outline } from './outline';
import { attempting, banner, say, showNumbers } from './messages';
import { Plot } from './plot';
import { Relighting } from './relighting';
import { nameCameras, nameScenes, showScene } from './scene-dialog';
import { Stage, type Picked } from './stage';
import { ask } from './upload';
import { Views } from './views';
import { merge, work } from './work';

const stage = new Stage($('canvas'));
const map = new LightMap();
const plot = new Plot($('plot'));
const worker = makeWorker();
const editor = new Editor({
  scene: () => scene,
  view: () => stage.view(),
  before() {
    map.remember();
    stage.remember();
    before = new Set(scene?.objects.map((o) => o.name));
  },
  accepted(job, label) {
    say(`${label}: accepted`);
    told(job);
  },
  conflict(label, again) {
    say(`${label}: not made`);
    void attempt(async () => {
      await refresh();
      banner(`Somebody else has changed the scene: “${label}” was not made. Look at what is there now.`, false, { 'Do it all the same': again, 'Leave it': () => {} });
    });
  },
  waiting(labels) {
    $('waiting').hidden = labels.length === 0;
    $('waiting-what').textContent = `The service is away. Waiting to be made: ${labels.join(', ')}.`;
  },
  dropped(label, why) {
    say(`${label}: dropped`);
    banner(`“${label}” was dropped: ${why}`);
    void attempt(refresh);
  },
  history: showHistory,
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
/** Accepted edits that the scene as it is shown has in it. */
let seen = 0;
/** Counts scenes that were opened: of two at once the later one stays. */
let opened = 0;
const library = new Library();

/** Runs something that may fail, and says how; what the service refused may rest on an old state of the scene. */
const attempt = (what: () => Promise<unknown>) => attempting(what, async () => scene && refresh());
const views = new Views(() => scene, stage, map, attempt);
const relighting = new Relighting(map);
const commands = new Commands({ scene: () => scene, picked: () => picked, choose, stops: () => views.exposure }, editor, stage, map);

// ---- scenes

async function listScenes(choose?: string): Promise<void> {
  const scenes = await nameScenes(scene?.id);
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
  const mine = ++opened;
  say('Laying out its elements …');
  const found = await client.prepared(id);
  if (mine !== opened) return;
  scene = found;
  seen = scene.accepted_edits;
  location.hash = id;
  $<HTMLSelectElement>('scenes').value = id;
  $('welcome').hidden = true;
  version = 0;
  await showMesh();
  nameCameras(scene);
  useCamera();
  stopStream = streamInWorker(worker, client, id, streamed);
  void listen(id);
  await editor.refresh();
  panels();
  if (scene?.lights.length === 0) offerLight();
}

/** Nothing shines: the way out is one button away. */
function offerLight(): void {
  const add = (kind: LampKind) => () => void attempt(() => commands.addLight(kind));
  banner('There is no light in this scene.', true, { 'Add a sky': add('sky'), 'Add a lamp': add('point'), 'Leave it dark': () => {} });
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
  // It may have been asked before the answer to an edit that came meanwhile.
  const { accepted_edits } = now;
  now.accepted_edits = Math.max(now.accepted_edits, scene.accepted_edits);
  const wasLit = scene.lights.length > 0;
  scene = now;
  const gone = picked && ![...now.objects, ...now.lights].some((x) => x.name === picked!.name);
  if (gone) picked = null;
  await showMesh();
  seen = accepted_edits;
  stage.select(picked);
  panels();
  // The layers' weights may be new.
  views.refresh();
  settle();
  prepare();
  await editor.refresh();
  if (wasLit && now.lights.length === 0) offerLight();
}

// ---- what the service tells

async function listen(id: string): Promise<void> {
  events = new AbortController();
  const { signal } = events;
  for await (const { type, data } of client.events(id, signal)) {
    if (signal.aborted) return;
    // Awaited, so that no older list comes after what events tell of a job.
    if (type === 'scene_state') await attempt(() => listJobs(id));
    else if (type === 'job') told(data);
    else if (type === 'scene' && data.what === 'deleted') void attempt(() => listScenes());
    else if (type === 'scene') void attempt(refresh);
    else if (type === 'reset') await attempt(() => listJobs(id).then(refresh));
    else if (type === 'snapshot' && scene) {
      scene.estimated_rmse = data.estimated_rmse;
      if (data.elements_version > scene.elements_version) void attempt(refresh);
    }
  }
}

/** Only once its events are heard: what ended before would never be told. */
async function listJobs(id: string): Promise<void> {
  const all = await client.jobs(id);
  if (scene?.id !== id) return;
  jobs = all;
  panelsOfWork();
  settle();
}

function told(job: Job): void {
  jobs = merge(jobs, job);
  const { estimated_rmse, elapsed_ms } = job.progress;
  if (typeof estimated_rmse === 'number') plot.add(job.id, elapsed_ms / 1000, estimated_rmse);
  if (job.state === 'failed') banner(`The job failed: ${job.error}`);
  if (scene && !isOpen(job)) scene.estimated_rmse = estimated_rmse ?? scene.estimated_rmse;
  panelsOfWork();
  // Layers and their weights are those of the newest version.
  if (scene && !isOpen(job)) void attempt(refresh);
  settle();
}

/** Once the service's map has all that was relit, it counts and not what the page worked out. */
function settle(): void {
  if (!dragged && jobs.every((job) => !isOpen(job) && (job.progress.version ?? 0) <= version)) relighting.rest();
}

let isLost = false;
/** After a lost connection: what happened meanwhile. The light map's stream resumes by itself. */
async function caughtUp(): Promise<void> {
  if (!scene) return;
  events.abort();
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
      if (isLost) {
        banner(null);
        void attempt(caughtUp).then(() => editor.resume());
      }
      isLost = false;
      say('Connected');
      break;
    case 'gone':
      banner('The service no longer has this scene: it was deleted, or the service was started anew. Upload it again.');
      void listScenes().catch(() => {});
      break;
    case 'failed': banner(data.why);
  }
}

function useCamera(): void {
  const camera = scene?.cameras[Number($<HTMLSelectElement>('cameras').value || -1)];
  camera ? stage.use(camera) : stage.overview();
}

// ---- editing

function choose(next: Picked | null): void {
  picked = next;
  stage.select(picked);
  panels();
  prepare();
}

/** Has the layer of the selected light at hand, for its sliders. */
function prepare(): void {
  const [at, l] = [scene, commands.light];
  if (at && l) void attempt(() => relighting.prepare(at, l));
}

/** A slider is in the hand: the light before it. */
let dragged: Light | undefined;

/** Shows a position of a slider where the page can work it out; sends it where the slider rests: one step of undo. */
function relight(color: Rgb, intensity: number, done: boolean): void {
  dragged ??= structuredClone(commands.light);
  const from = dragged;
  if (!scene || !from) return;
  if (views.isMap && relighting.show(scene, from, version, color, intensity)) stage.invalidate();
  if (!done) return;
  dragged = undefined;
  void attempt(async () => {
    if (!(await commands.relight(from, color, intensity))) relighting.rest();
  });
}

stage.onPick = choose;
stage.onCamera = () => scene && views.isPicture && views.refresh();
stage.onMoved = (_, delta) => void attempt(() => commands.move(delta));

async function upload(file: File, settings: Upload | null): Promise<void> {
  if (!settings) return;
  say(`Uploading ${file.name}…`);
  const created = await client.upload(file, settings);
  await listScenes(created.id);
  if (created.warnings.length && scene?.lights.length) banner(created.warnings.join('; '), true, { 'All right': () => {} });
}

async function addAsset(file: File): Promise<void> {
  say(`${await library.add(file)} is in the library: choose it to put it into the scene`);
  panels();
}

// ---- the page

function panels(): void {
  outline(scene, picked, choose);
  library.show((asset, name) => void attempt(() => commands.insert(asset, name)));
  views.offer(scene);
  details(scene, picked, {
    remove: () => void attempt(() => commands.remove()),
    duplicate: () => void attempt(() => commands.duplicate()),
    hide: (is) => void attempt(() => commands.hide(is)),
    toFloor: () => void attempt(() => commands.toFloor()),
    move: (by) => void attempt(() => commands.move(by)),
    aim: (direction) => void attempt(() => commands.aim(direction)),
    frame: () => stage.frameSelected(),
    relight,
    paint(albedo, done) {
      if (commands.object) stage.paint(commands.object.name, albedo);
      if (done) void attempt(() => commands.paint(albedo));
    },
  });
  for (const id of ['add-light', 'scene-more', 'add-asset']) $<HTMLButtonElement | HTMLSelectElement>(id).disabled = !scene;
  panelsOfWork();
}

function panelsOfWork(): void {
  work(jobs, scene, {
    cancel: (job) => void attempt(() => client.cancel(job.id)),
    pause: (job) => void attempt(async () => {
      const now = await client.pause(job.id);
      // The event that it is paused may be faster than the answer that it will be.
      if (jobs.find((one) => one.id === job.id)?.state !== 'paused') told(now);
    }),
    resume: (job) => void attempt(async () => told(await client.resume(job.id))),
    light: () => void attempt(() => commands.lightRest()),
  });
}

/** How the gizmo drags, and in which steps. */
function gizmo(mode = $<HTMLSelectElement>('gizmo').value): void {
  $<HTMLSelectElement>('gizmo').value = mode;
  stage.gizmoDoes(mode as 'translate' | 'rotate' | 'scale', Number($<HTMLSelectElement>('grid').value));
}

watchDialogs();
watchKeys({
  undo: () => void attempt(editor.undo),
  redo: () => void attempt(editor.redo),
  remove: () => void attempt(() => commands.remove()),
  duplicate: () => void attempt(() => commands.duplicate()),
  hide: () => void attempt(() => commands.hide()),
  toFloor: () => void attempt(() => commands.toFloor()),
  letGo: () => choose(null),
  split: () => views.split(!stage.split),
  frame: () => stage.frameSelected(),
  search: () => $('search').focus(),
  gizmo,
  expose: (by) => views.expose(views.exposure + by),
  view: (index) => views.set($<HTMLSelectElement>('view').options[index]?.value ?? views.current),
});
onFile('file', (file) => attempt(async () => upload(file, await ask(file))));
onFile('asset-file', (file) => attempt(() => addAsset(file)));
$('upload').addEventListener('click', () => $('file').click());
$('add-asset').addEventListener('click', () => $('asset-file').click());
$('add-light').addEventListener('change', ({ target }) => {
  const select = target as HTMLSelectElement;
  const kind = select.value as LampKind | '';
  select.value = '';
  if (kind) void attempt(() => commands.addLight(kind));
});
$('scene-more').addEventListener('click', () => {
  const deleted = () => void listScenes();
  const renamed = (now: Scene) => void attempt(async () => ((scene = now), await nameScenes(now.id)));
  if (scene) showScene(scene, { renamed, deleted, attempt });
});
$('search').addEventListener('input', panels);
for (const id of ['gizmo', 'grid']) $(id).addEventListener('change', () => gizmo());
$('waiting-drop').addEventListener('click', () => editor.dropAll());
$('undo').addEventListener('click', () => void attempt(editor.undo));
$('redo').addEventListener('click', () => void attempt(editor.redo));
$('scenes').addEventListener('change', ({ target }) => void attempt(() => open((target as HTMLSelectElement).value)));
$('view').addEventListener('change', ({ target }) => views.set((target as HTMLSelectElement).value));
$('split').addEventListener('change', ({ target }) => views.split((target as HTMLInputElement).checked));
$('cameras').addEventListener('change', useCamera);
$('exposure').addEventListener('input', ({ target }) => views.expose(Number((target as HTMLInputElement).value)));
onDrop((file) => attempt(async () => upload(file, await ask(file))));
showNumbers(() => stage.frameMs);
// For the console and for tests.
Object.assign(window, { rebake: { stage, map, relighting, client, state: () => ({ scene, version, jobs, fresh: seen >= (scene?.accepted_edits ?? 0), exposure: views.exposure, view: views.current }) } });

showHistory(null);
panels();
void attempt(() => listScenes());
