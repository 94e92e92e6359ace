// Colours as people write them: 8-bit sRGB. The API has linear RGB.

import { Color, LinearSRGBColorSpace, SRGBColorSpace } from 'three';
import type { Rgb } from 'rebake';

/** `#rrggbb` of linear RGB; what is above 1 is cut. */
export function toHex(linear: readonly number[]): string {
  const color = new Color().setRGB(...(linear.map((c) => Math.min(Math.max(c, 0), 1)) as Rgb), LinearSRGBColorSpace);
  return `#${color.getHexString(SRGBColorSpace)}`;
}

/** Linear RGB of `#rrggbb`, with or without the sign; null where it is none. */
export function fromHex(text: string): Rgb | null {
  const digits = /^#?([0-9a-f]{6})$/i.exec(text.trim())?.[1];
  if (!digits) return null;
  return new Color().setStyle(`#${digits}`, SRGBColorSpace).toArray() as Rgb;
}

/** A strength as a colour with its brightest channel at 1, and an intensity. */
export function split(color: readonly number[], intensity: number): { color: Rgb; intensity: number } {
  const most = Math.max(...color);
  if (!(most > 0)) return { color: [1, 1, 1], intensity: 0 };
  return { color: color.map((c) => c / most) as Rgb, intensity: intensity * most };
}
