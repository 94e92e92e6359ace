// What is selected, and what can be done with it.

import { Euler, Matrix4, Quaternion, Vector3 } from 'three';
import type { Light, Point, Rgb, Scene, SceneObject } from 'rebake';
import { split } from './colors';
import { $, button, make } from './dom';
import { color, isHeld, isTyping, number, short, slider, triple } from './fields';
import type { Picked } from './stage';

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
}

/** Shows what is selected. What is the same stays; what a person is changing is not taken out of their hands. */
export function details(scene: Scene | null, picked: Picked | null, actions: Actions): void {
  const parent = $('details');
  const focused = parent.contains(document.activeElement) ? nameOf(document.activeElement) : null;
  const object = picked?.kind === 'object' ? scene?.objects.find((o) => o.name === picked.name) : undefined;
  const light = picked && scene?.lights.find((l) => (picked.kind === 'light' ? l.name : l.object) === picked.name);
  const [of, shown] = [JSON.stringify(picked), JSON.stringify([object, light])];
  if (parent.dataset['of'] === of && (isHeld() || isTyping() || parent.dataset['shown'] === shown)) return;
  [parent.dataset['of'], parent.dataset['shown']] = [of, shown];
  parent.oninput = () => (parent.dataset['shown'] = '');
  if (!object && !light) {
    parent.replaceChildren(make('p', { class: 'quiet' }, 'Nothing. Click an object or a light.'));
    return;
  }
  const parts: HTMLElement[] = [make('strong', {}, picked!.name), buttons(object, light, actions)];
  if (object && !object.hidden) parts.push(...ofObject(object, actions));
  if (light) parts.push(...ofLight(light, actions, Boolean(object)));
  parent.replaceChildren(...parts);
  const again = [...parent.querySelectorAll<HTMLElement>('input, button')].find((item) => nameOf(item) === focused);
  if (focused) again?.focus();
}

const nameOf = (element: Element | null) => element?.getAttribute('aria-label') ?? element?.textContent ?? null;

function buttons(object: SceneObject | undefined, light: Light | null | undefined, actions: Actions): HTMLElement {
  const row = make('div', { class: 'actions' });
  const add = (text: string, action: () => void, title: string, kind = '') => {
    const one = button(text, action, kind);
    one.title = title;
    row.append(one);
    return one;
  };
  if (object && !object.hidden) {
    add('Frame', actions.frame, 'Fill the view with it (F)');
    add('Duplicate', actions.duplicate, 'Another one beside it (Ctrl+D)');
    add('To floor', actions.toFloor, 'Down onto what is below it (End)');
    add('Hide', () => actions.hide(true), 'Out of the light, to be brought back (H)');
  } else if (object) add('Show', () => actions.hide(false), 'Back into the light (H)');
  else if (light?.position) {
    add('Frame', actions.frame, 'Turn to it (F)');
    add('Duplicate', actions.duplicate, 'Another one beside it (Ctrl+D)');
  }
  add('Remove', actions.remove, 'Delete', 'bad').id = 'remove';
  return row;
}

const middle = ({ bounds: { min, max } }: SceneObject) => min.map((low, k) => (low + max[k]!) / 2) as Point;

function ofObject(object: SceneObject, actions: Actions): HTMLElement[] {
  const about = `${object.elements.count.toLocaleString('en')} elements, ${object.triangles.toLocaleString('en')} triangles`;
  return [
    make('p', { class: 'quiet' }, about),
    ...place(object, actions),
    color('Albedo', object.albedo, actions.paint),
  ];
}

/** Place, turn and size as numbers. An object turns and grows about its middle, wherever its origin is. */
function place(object: SceneObject, { move }: Actions): HTMLElement[] {
  const center = middle(object);
  const [at, turn, size] = [new Vector3(), new Quaternion(), new Vector3()];
  const now = new Matrix4().fromArray(object.transform);
  now.decompose(at, turn, size);
  const euler = new Euler().setFromQuaternion(turn, 'YXZ');
  const degrees = [euler.x, euler.y, euler.z].map((angle) => (angle * 180) / Math.PI) as Point;
  const become = (next: Matrix4) => {
    const pivot = new Matrix4().makeTranslation(...center);
    const linear = next.multiply(new Matrix4().compose(new Vector3(), turn, size).invert());
    move(pivot.clone().multiply(linear).multiply(pivot.clone().invert()));
  };
  return [
    triple('Position', 'metres', center, 0.1, (axis, value) => {
      const by: Point = [0, 0, 0];
      by[axis] = value - Number(center[axis].toFixed(3));
      move(new Matrix4().makeTranslation(...by));
    }),
    triple('Rotation', 'degrees', degrees, 5, (axis, value) => {
      const next = [...degrees] as Point;
      next[axis] = value;
      const [x, y, z] = next.map((angle) => (angle * Math.PI) / 180) as Point;
      become(new Matrix4().compose(new Vector3(), new Quaternion().setFromEuler(new Euler(x, y, z, 'YXZ')), size));
    }),
    triple('Scale', 'factor', size.toArray() as Point, 0.1, (axis, value) => {
      if (value === 0) return;
      const next = size.clone().setComponent(axis, value);
      become(new Matrix4().compose(new Vector3(), turn, next));
    }),
  ];
}

const UNITS = { emissive: 'W/(m² sr)', environment: 'W/(m² sr)', point: 'cd', spot: 'cd', directional: 'lx' };
const NAMES = { emissive: 'surface that shines', environment: 'sky', point: 'point', spot: 'spot', directional: 'directional' };

function ofLight(light: Light, actions: Actions, isObject: boolean): HTMLElement[] {
  let { color: tint, intensity } = split(light.color, light.intensity);
  const unit = light.rotation == null ? UNITS[light.kind] : 'times the picture';
  const send = (done: boolean) => actions.relight([...tint], intensity, done);
  const field = number(`Intensity, ${unit}`, intensity, { min: 0 }, (value) => {
    [intensity, range.value] = [value, String(stops(value))];
    send(true);
  });
  // In stops about what it is: the same step is the same change, however strong it is.
  const start = intensity > 0 ? intensity : 1;
  const stops = (value: number) => (value > 0 ? Math.log2(value / start) : -6);
  const range = slider('Intensity', [-6, 6, 0.1], stops(intensity), (value, done) => {
    intensity = value <= -6 ? 0 : start * 2 ** value;
    field.value = field.defaultValue = short(intensity);
    send(done);
  });
  const parts = [
    make('p', { class: 'quiet' }, NAMES[light.kind] === light.kind ? `${light.kind} light` : NAMES[light.kind]),
    make('div', { class: 'row strength' }, make('span', {}, 'Intensity'), range, field, make('small', {}, unit)),
    color('Colour', tint, (linear, done) => {
      tint = linear;
      send(done);
    }),
  ];
  if (light.position && !isObject) {
    const at = light.position;
    parts.push(triple('Position', 'metres', at, 0.1, (axis, value) => {
      const by: Point = [0, 0, 0];
      by[axis] = value - Number(at[axis].toFixed(3));
      actions.move(new Matrix4().makeTranslation(...by));
    }));
  }
  if (light.direction && !isObject) {
    const towards = light.direction;
    parts.push(triple('Direction', 'towards', towards, 0.1, (axis, value) => {
      const next = [...towards] as Point;
      next[axis] = value;
      if (next.some((x) => x !== 0)) actions.aim(next);
    }));
  }
  return parts;
}
