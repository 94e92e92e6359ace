// Things to type in, drag and pick, each with a name for those who do not see what stands around it.

import type { Point, Rgb } from 'rebake';
import { fromHex, toHex } from './colors';
import { make } from './dom';

/** A slider is held: what it stands on is not to be replaced. */
let held = false;
addEventListener('pointerup', () => (held = false));
addEventListener('pointercancel', () => (held = false));
export const isHeld = () => held;

/** Numbers as short as they can be without being other ones to a person. */
export const short = (x: number): string => String(Number(x.toPrecision(4)));

/** A number; what is none, or out of bounds, is not taken. */
export function number(name: string, value: number, options: { min?: number; step?: number }, set: (value: number) => void): HTMLInputElement {
  const field = make('input', { type: 'number', step: String(options.step ?? 'any'), 'aria-label': name, title: name });
  if (options.min !== undefined) field.min = String(options.min);
  field.value = field.defaultValue = short(value);
  field.addEventListener('change', () => {
    const now = field.valueAsNumber;
    if (!Number.isFinite(now) || (options.min !== undefined && now < options.min)) field.value = field.defaultValue;
    else if (field.value !== field.defaultValue) {
      field.defaultValue = field.value;
      set(now);
    }
  });
  return field;
}

/** Three numbers along the axes. */
export function triple(label: string, unit: string, at: Point, step: number, set: (axis: 0 | 1 | 2, value: number) => unknown): HTMLElement {
  const fields = (['x', 'y', 'z'] as const).map((axis, k) =>
    number(`${label} ${axis}, ${unit}`, Number(at[k]!.toFixed(3)), { step }, (value) => set(k as 0 | 1 | 2, value)),
  );
  return make('div', { class: 'triple' }, make('span', {}, label), ...fields);
}

/** A slider that tells every position, and where it rests (`done`). What it stands for may change while it stays. */
export function slider(name: string, [min, max, step]: [number, number, number], value: number, input: (value: number, done: boolean) => void): HTMLInputElement {
  const range = make('input', { type: 'range', min: String(min), max: String(max), step: String(step), 'aria-label': name });
  range.value = range.defaultValue = String(value);
  range.addEventListener('pointerdown', () => (held = true));
  range.addEventListener('input', () => input(Number(range.value), false));
  range.addEventListener('change', () => {
    if (range.value === range.defaultValue) return;
    range.defaultValue = range.value;
    input(Number(range.value), true);
  });
  return range;
}

/** A colour as a picker and as hexadecimal sRGB; linear RGB outside. */
export function color(name: string, linear: readonly number[], input: (linear: Rgb, done: boolean) => void): HTMLElement {
  const hex = toHex(linear);
  const picker = make('input', { type: 'color', 'aria-label': `${name}, sRGB`, value: hex });
  const text = make('input', { type: 'text', 'aria-label': `${name}, hexadecimal sRGB`, value: hex, maxlength: '7', spellcheck: 'false' });
  picker.addEventListener('input', () => {
    text.value = picker.value;
    input(fromHex(picker.value)!, false);
  });
  picker.addEventListener('change', () => input(fromHex(picker.value)!, true));
  text.addEventListener('change', () => {
    const read = fromHex(text.value);
    if (!read) text.value = picker.value;
    else {
      text.defaultValue = text.value = picker.value = toHex(read);
      input(read, true);
    }
  });
  return make('div', { class: 'row' }, make('span', {}, name), picker, text);
}
