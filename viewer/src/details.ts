// What is selected, and what can be done with it.

import { Euler, Matrix4, Quaternion, Vector3 } from 'three';
import type { Light, Point, Rgb, Scene, SceneObject } from 'rebake';
import { split } from './colors';
import { $, button, make } from './dom';
import { color, isHeld, number, short, slider, triple } from './fields';
import { show } from './patch';
import type { Picked } from './selection';

export interface Actions {
  remove(): void;
  duplicate(): void;
  hide(is: boolean): void;
  toFloor(): void;
  frame(): void;
  /** By a world-space matrix. */
  move(by: Matrix4): void;
  aim(direction: Point): void;
  paint(albedo: Rgb, done: boolean): void;
  relight(color: Rgb, intensity: number, done: boolean): void;
  /** Makes all lights that are selected so many times as strong. */
  dim(factor: number): void;
}

const NOTHING = 'Nothing. Click an object or a light; with Shift or Ctrl, several.';

/** What is there now: what is on the page may stay for longer than what it was made of. */
let now: Scene | null = null;
const objectNow = (name: string) => now?.objects.find((one) => one.name === name);
const lightNow = (name: string) => now?.lights.find((one) => one.name === name);

/** Shows what is selected. What is the same stays; what a person is changing is not taken out of their hands. */
export function details(scene: Scene | null, selected: readonly Picked[], actions: Actions): void {
  const parent = $('details');
  now = scene;
  const are = (kind: Picked['kind']) => new Set(selected.filter((one) => one.kind === kind).map(({ name }) => name));
  const [objectNames, lightNames] = [are('object'), are('light')];
  const objects = scene?.objects.filter(({ name }) => objectNames.has(name)) ?? [];
  const lights = scene?.lights.filter(({ name, object }) => lightNames.has(name) || (object && objectNames.has(object))) ?? [];
  const of = JSON.stringify([scene?.id, selected]);
  if (parent.dataset['of'] === of && isHeld()) return;
  // Of something else nothing stays, and neither does what was typed for it.
  if (parent.dataset['of'] !== of) parent.replaceChildren();
  parent.dataset['of'] = of;
  const focused = parent.contains(document.activeElement) ? nameOf(document.activeElement) : null;
  const parts =
    selected.length > 1 ? several(objects, lights, actions)
    : (objects[0] ?? lights[0]) ? single(selected[0]!, objects[0], lights[0], actions)
    : [make('p', { class: 'quiet' }, NOTHING)];
  if (show(parent, parts) || !focused) return;
  [...parent.querySelectorAll<HTMLElement>('input, button')].find((item) => nameOf(item) === focused)?.focus();
}

function single({ name }: Picked, object: SceneObject | undefined, light: Light | undefined, actions: Actions): HTMLElement[] {
  const parts: HTMLElement[] = [make('strong', {}, name), buttons(object ? [object] : [], light ? [light] : [], actions)];
  if (object && !object.hidden) parts.push(...ofObject(object, actions));
  if (light) parts.push(...ofLight(light, actions, Boolean(object)));
  return parts;
}

/** What can be said of, and done to, several at once. */
function several(objects: SceneObject[], lights: Light[], actions: Actions): HTMLElement[] {
  const own = lights.filter(({ object }) => !objects.some(({ name }) => name === object));
  const count = (n: number, what: string) => (n ? [`${n} ${what}${n > 1 ? 's' : ''}`] : []);
  const elements = objects.reduce((sum, one) => sum + one.elements.count, 0);
  const parts: HTMLElement[] = [
    make('strong', {}, [...count(objects.length, 'object'), ...count(own.length, 'light')].join(', ')),
    buttons(objects, own, actions),
  ];
  if (elements) parts.push(make('p', { class: 'quiet' }, `${elements.toLocaleString('en')} elements`));
  parts.push(triple('Move by', 'metres', [0, 0, 0], 0.1, (axis, value) => value !== 0 && actions.move(along(axis, value))));
  if (objects.length) parts.push(color('Albedo', objects.at(-1)!.albedo, actions.paint));
  if (lights.length) {
    const factor = number('Intensity, times', 1, { min: 0 }, actions.dim);
    parts.push(make('div', { class: 'row' }, make('span', {}, 'Intensity ×'), factor));
  }
  return parts;
}

const nameOf = (element: Element | null) => element?.getAttribute('aria-label') ?? element?.textContent ?? null;

function buttons(objects: SceneObject[], lights: Light[], actions: Actions): HTMLElement {
  const row = make('div', { class: 'actions' });
  const add = (text: string, action: () => void, title: string, kind = '') => {
    const one = button(text, action, kind);
    one.title = title;
    row.append(one);
    return one;
  };
  const them = objects.length + lights.length > 1 ? 'them' : 'it';
  const isShown = objects.some(({ hidden }) => !hidden);
  if (isShown || lights.some(({ position }) => position)) {
    add('Frame', actions.frame, `Fill the view with ${them} (F)`);
    add('Duplicate', actions.duplicate, them === 'it' ? 'Another one beside it (Ctrl+D)' : 'Others beside them (Ctrl+D)');
  }
  if (isShown) {
    add('To floor', actions.toFloor, `Down onto what is below ${them} (End)`);
    add('Hide', () => actions.hide(true), 'Out of the light, to be brought back (H)');
  }
  if (objects.some(({ hidden }) => hidden)) add('Show', () => actions.hide(false), 'Back into the light (H)');
  add('Remove', actions.remove, 'Delete', 'bad').id = 'remove';
  return row;
}

const middle = ({ bounds: { min, max } }: SceneObject) => min.map((low, k) => (low + max[k]!) / 2) as Point;

function ofObject(object: SceneObject, actions: Actions): HTMLElement[] {
  const about = `${object.elements.count.toLocaleString('en')} elements, ${object.triangles.toLocaleString('en')} triangles`;
  const { noise = null, resolution = null } = object.light_error;
  const errors = [['noise', noise] as const, ['resolution', resolution] as const].filter(([, error]) => error !== null);
  const stated = errors.map(([kind, error]) => `${error!.toPrecision(2)} of ${kind}`).join(', ');
  return [
    make('p', { class: 'quiet' }, about),
    // It stands there while nothing is known, too: a line that comes and goes would take what is typed below it along.
    make('p', { class: 'quiet', title: 'Errors of its light: irradiance / π' }, `Stated error: ${stated || 'not known yet'}`),
    ...place(object, actions),
    color('Albedo', object.albedo, actions.paint),
  ];
}

/** Where an object stands, its turn in degrees, and its size. */
function stand(object: SceneObject) {
  const [at, turn, size] = [new Vector3(), new Quaternion(), new Vector3()];
  new Matrix4().fromArray(object.transform).decompose(at, turn, size);
  const euler = new Euler().setFromQuaternion(turn, 'YXZ');
  const degrees = [euler.x, euler.y, euler.z].map((angle) => (angle * 180) / Math.PI) as Point;
  return { center: middle(object), turn, size, degrees };
}

/** Place, turn and size as numbers. An object turns and grows about its middle, wherever its origin is. */
function place(object: SceneObject, { move }: Actions): HTMLElement[] {
  const { center, degrees, size } = stand(object);
  /** Changes it from where it stands by now. */
  const change = (by: (its: ReturnType<typeof stand>, become: (next: Matrix4) => void) => void) => {
    const found = objectNow(object.name);
    if (!found) return;
    const its = stand(found);
    by(its, (next) => {
      const pivot = new Matrix4().makeTranslation(...its.center);
      const linear = next.multiply(new Matrix4().compose(new Vector3(), its.turn, its.size).invert());
      move(pivot.clone().multiply(linear).multiply(pivot.clone().invert()));
    });
  };
  return [
    triple('Position', 'metres', center, 0.1, (axis, value) => change((its) => move(along(axis, value - Number(its.center[axis].toFixed(3)))))),
    triple('Rotation', 'degrees', degrees, 5, (axis, value) => change((its, become) => {
      const next = [...its.degrees] as Point;
      next[axis] = value;
      const [x, y, z] = next.map((angle) => (angle * Math.PI) / 180) as Point;
      become(new Matrix4().compose(new Vector3(), new Quaternion().setFromEuler(new Euler(x, y, z, 'YXZ')), its.size));
    })),
    triple('Scale', 'factor', size.toArray() as Point, 0.1, (axis, value) => value !== 0 && change((its, become) => {
      become(new Matrix4().compose(new Vector3(), its.turn, its.size.clone().setComponent(axis, value)));
    })),
  ];
}

/** So far along an axis. */
function along(axis: 0 | 1 | 2, metres: number): Matrix4 {
  const by: Point = [0, 0, 0];
  by[axis] = metres;
  return new Matrix4().makeTranslation(...by);
}

const UNITS = { emissive: 'W/(m² sr)', environment: 'W/(m² sr)', point: 'cd', spot: 'cd', directional: 'lx' };
const NAMES = { emissive: 'surface that shines', environment: 'sky', point: 'point', spot: 'spot', directional: 'directional' };

function ofLight(light: Light, actions: Actions, isObject: boolean): HTMLElement[] {
  const { color: tint, intensity } = split(light.color, light.intensity);
  const unit = light.rotation == null ? UNITS[light.kind] : 'times the picture';
  /** As it is by now, with what is changed of it. */
  const send = (next: { color?: Rgb; intensity?: number }, done: boolean) => {
    const found = lightNow(light.name);
    if (!found) return;
    const its = split(found.color, found.intensity);
    actions.relight([...(next.color ?? its.color)], next.intensity ?? its.intensity, done);
  };
  const field = number(`Intensity, ${unit}`, intensity, { min: 0 }, (value) => {
    range.value = range.defaultValue = String(stops(value));
    send({ intensity: value }, true);
  });
  // In stops about what it is: the same step is the same change, however strong it is.
  const start = () => Number(range.dataset['start']);
  const stops = (value: number) => (value > 0 ? Math.log2(value / start()) : -6);
  const range = slider('Intensity', [-6, 6, 0.1], intensity > 0 ? 0 : -6, (value, done) => {
    const next = value <= -6 ? 0 : start() * 2 ** value;
    field.value = field.defaultValue = short(next);
    send({ intensity: next }, done);
  });
  range.dataset['start'] = String(intensity > 0 ? intensity : 1);
  const parts = [
    make('p', { class: 'quiet' }, NAMES[light.kind] === light.kind ? `${light.kind} light` : NAMES[light.kind]),
    make('div', { class: 'row strength' }, make('span', {}, 'Intensity'), range, field, make('small', {}, unit)),
    color('Colour', tint, (linear, done) => send({ color: linear }, done)),
  ];
  if (light.position && !isObject) {
    parts.push(triple('Position', 'metres', light.position, 0.1, (axis, value) => {
      const at = lightNow(light.name)?.position;
      if (at) actions.move(along(axis, value - Number(at[axis].toFixed(3))));
    }));
  }
  if (light.direction && !isObject) {
    parts.push(triple('Direction', 'towards', light.direction, 0.1, (axis, value) => {
      const next = [...(lightNow(light.name)?.direction ?? [0, 0, 0])] as Point;
      next[axis] = value;
      if (next.some((x) => x !== 0)) actions.aim(next);
    }));
  }
  return parts;
}
