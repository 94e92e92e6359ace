// The lists and forms beside the scene.

import { isOpen, type Job, type Light, type Point, type Rgb, type Scene, type SceneObject } from 'rebake';
import type { Picked } from './stage';

export const $ = <T extends HTMLElement>(id: string): T => document.getElementById(id) as T;

/** Builds an element. */
export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  attributes: Record<string, string> = {},
  ...children: (Node | string)[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

export function button(text: string, action: () => void, kind = ''): HTMLButtonElement {
  const element = make('button', { type: 'button', class: kind }, text);
  element.addEventListener('click', action);
  return element;
}

/** A list of things to select, with the arrow keys too. */
export function list(id: string, names: string[], chosen: string | null, choose: (name: string) => void): void {
  const parent = $<HTMLUListElement>(id);
  const focused = parent.contains(document.activeElement) ? document.activeElement?.textContent : null;
  const buttons = names.map((name) => {
    const item = button(name, () => choose(name));
    item.setAttribute('aria-pressed', String(name === chosen));
    item.title = name;
    return item;
  });
  parent.onkeydown = (event) => {
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    const at = buttons.indexOf(document.activeElement as HTMLButtonElement);
    if (step && at >= 0) {
      buttons[at + step]?.focus();
      event.preventDefault();
    }
  };
  parent.replaceChildren(...buttons.map((item) => make('li', {}, item)));
  buttons.find((item) => item.textContent === focused)?.focus();
}

/** A slider is held: what it stands on is not to be replaced. */
let held = false;
addEventListener('pointerup', () => (held = false));
addEventListener('pointercancel', () => (held = false));

/** `name` says of what, for those who do not see what stands around it. */
function slider(
  name: string,
  label: string,
  [min, max, step]: [number, number, number],
  value: number,
  show: (value: number) => string,
  input: (value: number, done: boolean) => void,
): HTMLLabelElement {
  const range = make('input', { type: 'range', min: String(min), max: String(max), step: String(step), 'aria-label': name });
  range.value = String(value);
  range.addEventListener('pointerdown', () => (held = true));
  const output = make('output', {}, show(value));
  range.addEventListener('input', () => {
    output.textContent = show(Number(range.value));
    input(Number(range.value), false);
  });
  range.addEventListener('change', () => input(Number(range.value), true));
  return make('label', { class: 'row' }, label, range, output);
}

const two = (x: number) => x.toFixed(2);

export interface Actions {
  remove(): void;
  paint(albedo: Rgb, done: boolean): void;
  relight(color: Rgb, intensity: number, done: boolean): void;
  frame(): void;
  /** By so many metres along the axes. */
  move(by: Point): void;
}

/** What is selected, and what can be done with it. */
export function details(scene: Scene | null, picked: Picked | null, actions: Actions): void {
  const parent = $('details');
  const focused = parent.contains(document.activeElement) ? nameOf(document.activeElement) : null;
  const object = picked?.kind === 'object' && scene?.objects.find((o) => o.name === picked.name);
  const light =
    picked &&
    scene?.lights.find((l) => (picked.kind === 'light' ? l.name === picked.name : l.object === picked.name));
  const [of, shown] = [JSON.stringify(picked), JSON.stringify([object, light])];
  // What is the same stays; what a person is changing is not taken out of their hands.
  if (parent.dataset['of'] === of && (held || isTyping() || parent.dataset['shown'] === shown)) return;
  [parent.dataset['of'], parent.dataset['shown']] = [of, shown];
  parent.oninput = () => (parent.dataset['shown'] = '');
  if (!object && !light) {
    parent.replaceChildren(make('p', { class: 'quiet' }, 'Nothing. Click an object or a light.'));
    return;
  }
  const parts: HTMLElement[] = [make('strong', {}, picked!.name)];
  if (object) parts.push(...ofObject(object, actions));
  if (light) parts.push(...ofLight(light, actions));
  const remove = button('Remove', actions.remove, 'bad');
  remove.id = 'remove';
  parts.push(make('div', { class: 'actions' }, button('Look at', actions.frame), remove));
  const at = object ? middle(object) : light?.position;
  if (at) parts.push(place(at, actions.move), make('p', { class: 'quiet' }, 'Or drag the arrows in the scene.'));
  parent.replaceChildren(...parts);
  const again = [...parent.querySelectorAll<HTMLElement>('input, button')].find((item) => nameOf(item) === focused);
  if (focused) again?.focus();
}

/** A number is half written. */
function isTyping(): boolean {
  const field = document.activeElement;
  return field instanceof HTMLInputElement && field.type === 'number' && field.value !== field.defaultValue;
}

const nameOf = (element: Element | null) => element?.getAttribute('aria-label') ?? element?.textContent ?? null;
const middle = ({ bounds: { min, max } }: SceneObject) => min.map((low, k) => (low + max[k]!) / 2) as Point;

/** Where something is, as numbers that can be changed: moving without a mouse. */
function place(at: Point, moved: (by: Point) => void): HTMLElement {
  const fields = (['x', 'y', 'z'] as const).map((axis, k) => {
    const field = make('input', { type: 'number', step: '0.1', 'aria-label': `Position ${axis}, metres`, title: `${axis}, metres` });
    field.value = field.defaultValue = at[k]!.toFixed(2);
    const shown = Number(field.value);
    field.addEventListener('change', () => {
      field.defaultValue = field.value;
      const by: Point = [0, 0, 0];
      by[k] = Number(field.value) - shown;
      if (Number.isFinite(by[k]) && by[k] !== 0) moved(by);
    });
    return field;
  });
  return make('div', { class: 'place' }, make('span', {}, 'Position'), ...fields);
}

function ofObject(object: SceneObject, actions: Actions): HTMLElement[] {
  const albedo: Rgb = [...object.albedo];
  const channel = (name: string, k: 0 | 1 | 2) =>
    slider(`Albedo ${name}`, k ? name : `Albedo ${name}`, [0, 1, 0.01], albedo[k], two, (value, done) => {
      albedo[k] = value;
      actions.paint([...albedo], done);
    });
  const about = `${object.elements.count.toLocaleString('en')} elements, ${object.triangles.toLocaleString('en')} triangles`;
  return [
    make('p', { class: 'quiet' }, about),
    channel('red', 0),
    channel('green', 1),
    channel('blue', 2),
  ];
}

function ofLight(light: Light, actions: Actions): HTMLElement[] {
  const color: Rgb = [...light.color];
  let intensity = light.intensity;
  const units = { emissive: 'W/(m² sr)', environment: 'W/(m² sr)', point: 'cd', spot: 'cd', directional: 'lx' };
  const send = (done: boolean) => actions.relight([...color], intensity, done);
  const channel = (name: string, k: 0 | 1 | 2) =>
    slider(`Light ${name}`, k ? name : `Light ${name}`, [0, Math.max(1, light.color[k]), 0.01], color[k], two, (value, done) => {
      color[k] = value;
      send(done);
    });
  const most = Math.max(4 * light.intensity, 10);
  const strength = slider('Intensity', 'Intensity', [0, most, most / 200], intensity, (v) => v.toPrecision(3), (value, done) => {
    intensity = value;
    send(done);
  });
  return [
    make('p', { class: 'quiet' }, `${light.kind} light, ${units[light.kind]}`),
    strength,
    channel('red', 0),
    channel('green', 1),
    channel('blue', 2),
  ];
}

const seconds = (ms: number) => (ms < 9950 ? `${(ms / 1000).toFixed(1)} s` : `${Math.round(ms / 1000)} s`);

/** The running job, and those that wait. */
export function work(jobs: Job[], rmse: number | null, cancel: (job: Job) => void): void {
  const running = jobs.find((job) => job.state === 'running');
  const last = jobs[0];
  const parent = $('job');
  if (running) {
    const { fraction, elapsed_ms, remaining_ms: left = null, estimated_rmse = null, pass, samples_per_element } = running.progress;
    const error = estimated_rmse === null ? 'no light yet' : `stated error ${estimated_rmse.toPrecision(3)}`;
    const text = [
      `${running.kind}, ${(pass ?? 'starting').replace('_', ' ')}`,
      `${samples_per_element} samples per element, ${error}`,
      `${seconds(elapsed_ms)} gone${left === null ? '' : `, about ${seconds(left)} left`}`,
    ];
    const bar = make('progress', { max: '1', 'aria-label': 'Progress' });
    bar.value = fraction;
    const stop = button(running.cancel_requested ? 'Stopping…' : 'Cancel', () => cancel(running), 'bad');
    stop.disabled = running.cancel_requested;
    parent.replaceChildren(bar, ...text.map((line) => make('p', { class: 'quiet' }, line)), stop);
  } else {
    const how = last ? { failed: `failed: ${last.error ?? ''}`, canceled: 'was canceled' }[last.state as string] : null;
    const text = how ? `The last job ${how}.` : rmse === null ? 'Nothing to do.' : rmse === 0 ? 'Up to date.' : `Up to date, stated error ${rmse.toPrecision(3)}.`;
    parent.replaceChildren(make('p', { class: 'quiet' }, text));
  }
  const waiting = jobs.filter((job) => isOpen(job) && job !== running).reverse();
  const how = (job: Job) => (job.state === 'paused' ? 'is paused' : job.merged_into ? 'is done with the one that runs' : 'waits');
  const items = waiting.map((job) => make('li', {}, `${job.kind} ${how(job)}`, button('Cancel', () => cancel(job))));
  $('queue').replaceChildren(...items);
}
