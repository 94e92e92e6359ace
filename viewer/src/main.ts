// Wires it all together: one scene at a time, followed live.

import { isOpen, type Job, type Light, type Rgb, type Scene, type Snapshot } from 'rebake';
import { client } from './api';
import { Arrivals } from './arrivals';
import { coalesce } from './coalesce';
import { Commands } from './commands';
import { watchControls } from './controls';
import { details } from './details';
import { $ } from './dom';
import { Editor } from './editor';
import { Feed } from './feed';
import { onFile, watchDrops } from './files';
import { showHistory } from './history';
import { watchDialogs, watchKeys } from './keys';
import type { LampKind } from './lamps';
import { Library } from './library';
import { LightMap } from './lightmap';
import { attempting, banner, say, showNumbers } from './messages';
import { Outline } from './outline';
import { Plot } from './plot';
import { Relighting } from './relighting';
import { nameCameras, nameScenes, showScene } from './scene-dialog';
import { Selection, type Picked } from './selection';
import { Stage } from './stage';
import { ask } from './upload';
import { Views } from './views';
import { work } from './work';

const stage = new Stage($('canvas'));
const map = new LightMap();
const plot = new Plot($('plot'));
const selection = new Selection();
const feed = new Feed({
  job: heard,
  jobs: () => (panelsOfWork(), settle()),
  scene: () => refresh(),
  snapshot,
  stated(error, each, elementsVersion) {
    if (!scene) return;
    Object.assign(scene, { estimated_rmse: error, light_error: each });
    if (elementsVersion > scene.elements_version) void attempt(refresh);
  },
  back: async () => editor.resume(),
  deleted: () => void attempt(() => listScenes()),
  attempt,
});
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
    feed.told(job);
  },
  conflict(label, again) {
    say(`${label}: not made`);
    stage.settleBack();
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
    stage.settleBack();
    void attempt(refresh);
  },
  history: showHistory,
});

let scene: Scene | null = null;
/** Names of the objects before the last edit: the others have no light to compare with. */
let before = new Set<string>();
let shownMesh = '';
/** Accepted edits that the objects and lights of the scene have in them, published or not. */
let toldEdits = 0;
/** Accepted edits that the scene as it is shown has in it; −1 while another one is about to be shown. */
let seen = 0;
/** Counts scenes that were opened: of two at once the later one stays. */
let opened = 0;
const library = new Library();
const outline = new Outline(choose);
const views = new Views(() => scene, stage, map, attempt, () => feed.filter);
const relighting = new Relighting(map, () => feed.filter);
const grid = () => Number($<HTMLSelectElement>('grid').value);
const commands = new Commands({ scene: () => scene, selection, choose, stops: () => views.exposure, grid }, editor, stage, map);
const arrivals = new Arrivals({ scene: () => scene, open: listScenes, panels }, library, stage, commands);

/** Runs something that may fail, and says how; what the service refused may rest on an old state of the scene. */
function attempt(what: () => Promise<unknown>): Promise<void> {
  return attempting(what, async () => scene && refresh());
}

// ---- scenes

async function listScenes(choose?: string): Promise<void> {
  const scenes = await nameScenes(scene?.id);
  const wanted = choose ?? location.hash.slice(1);
  const found = scenes.find((s) => s.id === wanted) ?? scenes[0];
  if (found) await open(found.id);
  else leave();
}

function leave(): void {
  feed.stop();
  selection.choose([]);
  [scene, shownMesh] = [null, ''];
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
  toldEdits = scene.accepted_edits;
  seen = scene.published_edits;
  location.hash = id;
  $<HTMLSelectElement>('scenes').value = id;
  $('welcome').hidden = true;
  await showMesh();
  nameCameras(scene);
  useCamera();
  feed.follow(id);
  await editor.refresh();
  panels();
  // Beside the scene: it is there without what else could be put into it.
  void attempt(() => library.refresh().then(panels));
  if (scene?.lights.length === 0) offerLight();
}

/** Nothing shines: the way out is one button away. */
function offerLight(): void {
  const add = (kind: LampKind) => () => void attempt(() => commands.addLight(kind));
  banner('There is no light in this scene.', true, { 'Add a sky': add('sky'), 'Add a lamp': add('point'), 'Leave it dark': () => {} });
}

/** Fetches the mesh where its elements changed since. */
async function showMesh(): Promise<void> {
  // What was accepted and is not published yet comes with its version, what is in the hand is shown there: until then the
  // mesh is that of before.
  const isBehind = stage.isHeld || scene!.published_edits < toldEdits;
  const key = isBehind ? 'behind' : JSON.stringify(scene!.objects.map((o) => [o.name, o.elements, o.bounds, o.transform]));
  if (key === shownMesh || (isBehind && shownMesh)) {
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

/** Shows the scene as it is now. */
const refresh = coalesce(async () => {
  if (!scene) return;
  const id = scene.id;
  const now = await client.scene(id);
  if (scene?.id !== id) return;
  // It may have been asked before the answer to an edit that came meanwhile.
  const { accepted_edits, published_edits } = now;
  now.accepted_edits = Math.max(now.accepted_edits, scene.accepted_edits);
  const last = scene;
  // None of it is shown yet, not even where this was accepted before.
  [scene, seen, toldEdits] = [now, -1, accepted_edits];
  // What was accepted and is selected already may not be there yet.
  const has = (of: Scene, { kind, name }: Picked) => (kind === 'object' ? of.objects : of.lights).some((one) => one.name === name);
  selection.keep((one) => has(now, one) || !has(last, one));
  await showMesh();
  if (scene?.id !== id) return;
  seen = published_edits;
  stage.select(selection.all);
  panels();
  // The layers' weights may be new.
  views.refresh();
  settle();
  prepare();
  await editor.refresh();
  if (last.lights.length > 0 && now.lights.length === 0) offerLight();
});

// ---- what the service tells

function heard(job: Job): void {
  const { estimated_rmse, light_error, elapsed_ms } = job.progress;
  if (typeof estimated_rmse === 'number') plot.add(job.id, elapsed_ms / 1000, estimated_rmse);
  if (scene && !isOpen(job) && typeof estimated_rmse === 'number') Object.assign(scene, { estimated_rmse, light_error });
  panelsOfWork();
  // Layers and their weights are those of the newest version.
  if (scene && !isOpen(job)) void attempt(refresh);
  settle();
}

/** Once the service's map has all that was relit, it counts and not what the page worked out. */
function settle(): void {
  if (!dragged && feed.isComplete) relighting.rest();
}

function snapshot({ frames, version, elements, ms }: Snapshot): void {
  const grown = map.snapshot(frames);
  // The arrays were replaced: the mesh has to look into the new ones.
  if (grown && scene) {
    shownMesh = '';
    void attempt(refresh);
  }
  const rate = elements > 10_000 ? `, decoded at ${Math.round(elements / ms / 1000)} M elements/s` : '';
  $('numbers').dataset['stream'] = `version ${version}: ${elements.toLocaleString('en')} values${rate}`;
  settle();
  views.refresh();
  stage.invalidate();
}

function useCamera(): void {
  const camera = scene?.cameras[Number($<HTMLSelectElement>('cameras').value || -1)];
  camera ? stage.use(camera) : stage.overview();
}

// ---- editing

function choose(next: readonly Picked[], isMore = false): void {
  selection.choose(next, isMore);
  stage.select(selection.all);
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
  if (views.isMap && relighting.show(scene, from, feed.version, color, intensity)) stage.invalidate();
  if (!done) return;
  dragged = undefined;
  void attempt(async () => {
    if (!(await commands.relight(from, color, intensity))) relighting.rest();
  });
}

stage.onPick = (picked, isMore) => {
  if (picked || !isMore) choose(picked ? [picked] : [], isMore);
};
stage.onCamera = () => scene && views.isPicture && views.refresh();
stage.onGrab = () => commands.grab();
stage.onDrag = (by) => void attempt(() => commands.drag(by));
stage.onDrop = (by) => void attempt(() => commands.drop(by));

// ---- the page

function panels(): void {
  outline.show(scene, selection);
  library.show((thing) => void attempt(() => commands.insert(thing, stage.ahead())));
  views.offer(scene);
  details(scene, selection.all, {
    remove: () => void attempt(() => commands.remove()),
    duplicate: () => void attempt(() => commands.duplicate()),
    hide: (is) => void attempt(() => commands.hide(is)),
    toFloor: () => void attempt(() => commands.toFloor()),
    move: (by) => void attempt(() => commands.move(by)),
    aim: (direction) => void attempt(() => commands.aim(direction)),
    frame: () => stage.frameSelected(),
    relight,
    dim: (factor) => void attempt(() => commands.dim(factor)),
    paint(albedo, done) {
      for (const { name } of commands.objects) stage.paint(name, albedo);
      if (done) void attempt(() => commands.paint(albedo));
    },
  });
  for (const id of ['add-light', 'scene-more', 'add-asset']) $<HTMLButtonElement | HTMLSelectElement>(id).disabled = !scene;
  panelsOfWork();
}

function panelsOfWork(): void {
  work(feed.jobs, scene, {
    cancel: (job) => void attempt(() => client.cancel(job.id)),
    pause: (job) => void attempt(async () => {
      const now = await client.pause(job.id);
      // The event that it is paused may be faster than the answer that it will be.
      if (feed.jobs.find((one) => one.id === job.id)?.state !== 'paused') feed.told(now);
    }),
    resume: (job) => void attempt(async () => feed.told(await client.resume(job.id))),
    light: () => void attempt(() => commands.lightRest()),
  });
}

/** How the gizmo drags, and in which steps. */
function gizmo(mode = $<HTMLSelectElement>('gizmo').value): void {
  $<HTMLSelectElement>('gizmo').value = mode;
  stage.gizmoDoes(mode as 'translate' | 'rotate' | 'scale', grid());
}

/** Light with its noise averaged away, or as it is kept. */
function filter(is = feed.filter === 'none'): void {
  $<HTMLInputElement>('filter').checked = is;
  feed.setFilter(is ? 'statistical' : 'none');
  prepare();
}

watchDialogs();
watchKeys({
  undo: () => void attempt(editor.undo),
  redo: () => void attempt(editor.redo),
  remove: () => void attempt(() => commands.remove()),
  duplicate: () => void attempt(() => commands.duplicate()),
  hide: () => void attempt(() => commands.hide()),
  toFloor: () => void attempt(() => commands.toFloor()),
  letGo: () => choose([]),
  all: () => scene && choose(scene.objects.map(({ name }) => ({ kind: 'object', name }))),
  filter,
  split: () => views.split(!stage.split),
  frame: () => stage.frameSelected(),
  search: () => $('search').focus(),
  gizmo,
  expose: (by) => views.expose(views.exposure + by),
  view: (index) => views.set($<HTMLSelectElement>('view').options[index]?.value ?? views.current),
});
onFile('file', (file) => attempt(async () => arrivals.upload(file, await ask(file))));
onFile('asset-file', (file) => attempt(() => arrivals.asset(file)));
watchControls({
  open: (id) => void attempt(() => open(id)),
  about() {
    const deleted = () => void attempt(() => listScenes());
    const renamed = (now: Scene) => void attempt(async () => ((scene = now), await nameScenes(now.id)));
    if (scene) showScene(scene, { renamed, deleted, attempt });
  },
  undo: () => void attempt(editor.undo),
  redo: () => void attempt(editor.redo),
  addLight: (kind) => void attempt(() => commands.addLight(kind)),
  search: panels,
  gizmo: () => gizmo(),
  dropWaiting: () => editor.dropAll(),
  view: (name) => views.set(name),
  filter,
  split: (is) => views.split(is),
  camera: useCamera,
  expose: (stops) => views.expose(stops),
});
watchDrops({
  canPlace: () => scene !== null,
  scene: (file) => void attempt(async () => arrivals.upload(file, await ask(file))),
  library: (file) => void attempt(() => arrivals.asset(file)),
  place: (what, at) => void attempt(() => arrivals.place(what, at)),
});
showNumbers(() => stage.frameMs);
// For the console and for tests.
const state = () => ({
  scene, version: feed.version, jobs: feed.jobs, filter: feed.filter, selected: selection.all,
  fresh: seen >= (scene?.accepted_edits ?? 0), exposure: views.exposure, view: views.current,
});
Object.assign(window, { rebake: { stage, map, relighting, client, state } });

showHistory(null);
panels();
void attempt(() => listScenes());
