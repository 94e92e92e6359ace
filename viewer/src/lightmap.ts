// The light map on the page's side: what is current, what it was before the edit, what is shown.

import { DynamicDrawUsage, BufferAttribute } from 'three';
import { apply, reach, readVertices, type Frame, type Reads, type Rgb, type SceneObject } from 'rebake';

/** Marks elements that were not there before the edit. Estimated light may be a little below 0, never this far. */
const NEW = -1e30;

/** Elements of one object as vertex attributes; they look into the map's own arrays, or hold means of what is there. */
interface Window {
  first: number;
  count: number;
  light: BufferAttribute;
  base: BufferAttribute;
  reads: Reads | undefined;
}

export class LightMap {
  /** Direct + indirect (or what the scene's mode says) per element, RGB. */
  current = new Float32Array();
  /** The same, before the last edit. */
  base = new Float32Array();
  /** What the attributes show: `current`, or one layer of it. */
  private shown = new Float32Array();
  /** In the order of their elements, which no two share. */
  private windows: Window[] = [];
  private readonly stale = new Set<Window>();
  private followsCurrent = true;
  /** Whether the light before the edit is looked at, and whether the graphics card has an older one. */
  private showsBase = false;
  private isBaseStale = false;

  get elements(): number {
    return this.current.length / 3;
  }

  clear(): void {
    this.current = new Float32Array();
    this.base = new Float32Array();
    this.shown = new Float32Array();
    this.windows = [];
  }

  /** Room for so many elements. Attributes made before look into the old arrays: answers whether that happened. */
  grow(elements: number): boolean {
    if (elements <= this.elements) return false;
    const larger = (old: Float32Array, fill: number) => {
      const array = new Float32Array(3 * elements).fill(fill, old.length);
      array.set(old);
      return array;
    };
    this.current = larger(this.current, 0);
    this.base = larger(this.base, NEW);
    this.shown = larger(this.shown, 0);
    return true;
  }

  /** Applies a whole snapshot; answers whether attributes have to be made anew. */
  snapshot(frames: Frame[]): boolean {
    const grown = this.grow(Math.max(0, ...frames.map(reach)));
    for (const frame of frames) {
      const ranges = apply(frame, this.current);
      if (!this.followsCurrent || grown) continue;
      for (const [first, count] of ranges) {
        this.shown.set(this.current.subarray(3 * first, 3 * (first + count)), 3 * first);
        this.touch(first, count);
      }
    }
    if (grown && this.followsCurrent) this.shown.set(this.current);
    this.settle();
    return grown;
  }

  /** An edit is about to change the light. */
  remember(): void {
    this.base.set(this.current);
    this.touchBase();
  }

  /** Elements that now belong to something else have no past. */
  forget(first: number, count: number): void {
    this.base.fill(NEW, 3 * first, 3 * (first + count));
    this.touchBase();
  }

  /** The light before the edit is looked at, or no more: only while it is does every edit upload it anew. */
  showBase(is: boolean): void {
    this.showsBase = is;
    if (is && this.isBaseStale) this.touchBase();
  }

  /** Shows the map itself again. */
  showCurrent(): void {
    this.followsCurrent = true;
    this.shown.set(this.current);
    this.touchAll();
  }

  /** Shows one layer, each channel times a factor. */
  showLayer(frames: Frame[], weight: Rgb = [1, 1, 1]): void {
    this.followsCurrent = false;
    for (const frame of frames) if (reach(frame) <= this.elements) apply(frame, this.shown);
    const [r, g, b] = weight;
    if (weight.some((factor) => factor !== 1)) {
      for (let i = 0; i < this.shown.length; i += 3) {
        this.shown[i]! *= r;
        this.shown[i + 1]! *= g;
        this.shown[i + 2]! *= b;
      }
    }
    this.touchAll();
  }

  /** Shows base + change × layer, as long as the map has the length of both. */
  showSum(base: Float32Array, layer: Float32Array, [r, g, b]: Rgb): void {
    if (base.length !== this.shown.length || layer.length !== base.length) return;
    this.followsCurrent = false;
    const { shown } = this;
    for (let i = 0; i < base.length; i += 3) {
      shown[i] = base[i]! + r * layer[i]!;
      shown[i + 1] = base[i + 1]! + g * layer[i + 1]!;
      shown[i + 2] = base[i + 2]! + b * layer[i + 2]!;
    }
    this.touchAll();
  }

  /** Attributes for an object's vertices. */
  attributes({ elements: { first, count } }: SceneObject, reads?: Reads): { light: BufferAttribute; base: BufferAttribute } {
    const window = (array: Float32Array) => {
      const own = array.subarray(3 * first, 3 * (first + count));
      const attribute = new BufferAttribute(reads ? new Float32Array(reads.elements.length) : own, 3);
      attribute.setUsage(DynamicDrawUsage);
      return attribute;
    };
    const pair = { light: window(this.shown), base: window(this.base) };
    const made = { first, count, reads, ...pair };
    this.read(made, pair.light, this.shown);
    this.read(made, pair.base, this.base);
    this.windows.push(made);
    this.windows.sort((a, b) => a.first - b.first);
    return pair;
  }

  /** Where vertices share elements, what they read of an array of the map. */
  private read({ first, count, reads }: Window, attribute: BufferAttribute, from: Float32Array): void {
    if (reads) readVertices(reads, from.subarray(3 * first, 3 * (first + count)), attribute.array as Float32Array);
  }

  /** No attributes are in use any more. */
  release(): void {
    this.windows = [];
    this.stale.clear();
  }

  /** The mean of an object's light, RGB mean: for tests and the console. */
  mean({ elements: { first, count } }: SceneObject): number {
    let sum = 0;
    for (let i = 3 * first; i < 3 * (first + count); i++) sum += this.current[i]!;
    return sum / (3 * count);
  }

  /** The mean over the elements of all objects: a measure of how bright things are. */
  meanOf(objects: SceneObject[]): number {
    let [sum, count] = [0, 0];
    for (const object of objects) {
      if (object.elements.count === 0) continue;
      sum += this.mean(object) * object.elements.count;
      count += object.elements.count;
    }
    return count ? sum / count : 0;
  }

  /** The size that few changes pass: for the colour scale. */
  changeScale(): number {
    const sizes: number[] = [];
    const step = Math.max(1, Math.floor(this.elements / 20000));
    for (let i = 0; i < this.elements; i += step) {
      if (this.base[3 * i]! < 0.5 * NEW) continue;
      let change = 0;
      for (let k = 3 * i; k < 3 * i + 3; k++) change += this.current[k]! - this.base[k]!;
      if (change !== 0) sizes.push(Math.abs(change / 3));
    }
    if (sizes.length === 0) return 1;
    sizes.sort((a, b) => a - b);
    const wanted = sizes[Math.floor(sizes.length * 0.98)]!;
    const decade = 10 ** Math.floor(Math.log10(wanted));
    return [1, 2, 5, 10].map((step) => step * decade).find((size) => size >= wanted * 0.999999) ?? wanted;
  }

  private touchAll(): void {
    this.touch(0, this.elements);
    this.settle();
  }

  private touch(first: number, count: number): void {
    // A snapshot has thousands of ranges, a scene thousands of objects.
    let [low, high] = [0, this.windows.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.windows[middle]!.first + this.windows[middle]!.count <= first) low = middle + 1;
      else high = middle;
    }
    for (let k = low; k < this.windows.length && this.windows[k]!.first < first + count; k++) {
      const window = this.windows[k]!;
      const from = Math.max(first, window.first);
      const to = Math.min(first + count, window.first + window.count);
      if (window.reads) {
        this.stale.add(window);
        continue;
      }
      // Thousands of little uploads cost more than one that is too large.
      if (window.light.updateRanges.length < 64) window.light.addUpdateRange(3 * (from - window.first), 3 * (to - from));
      else {
        window.light.clearUpdateRanges();
        window.light.addUpdateRange(0, 3 * window.count);
      }
      window.light.needsUpdate = true;
    }
  }

  /** Reads anew where vertices share elements that were touched: once, however many ranges there were. */
  private settle(): void {
    for (const window of this.stale) {
      this.read(window, window.light, this.shown);
      window.light.needsUpdate = true;
    }
    this.stale.clear();
  }

  private touchBase(): void {
    this.isBaseStale = !this.showsBase;
    for (const window of this.windows) {
      this.read(window, window.base, this.base);
      if (this.showsBase) window.base.needsUpdate = true;
    }
  }
}
