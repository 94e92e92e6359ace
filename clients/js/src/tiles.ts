// Tiles of atlas pages, version 1: rectangles of texels that changed, little-endian (docs/delta-format.md).

import { crc32, fromHalf, HALF, LAST, REPLACE } from './frames.js';

const MAGIC = 0x544b4252; // "RBKT"
const [HEADER, PAGE, TILE] = [40, 8, 20];
/** Texels of all pages together: what the service's own reader takes. */
const MAX_TEXELS = 2 ** 28;

/** A rectangle of a page. */
export interface Place {
  page: number;
  /** Its first column and row, from the top left. */
  x: number;
  y: number;
  width: number;
  height: number;
}

/** A rectangle of a page with what its texels hold. */
export interface Tile extends Place {
  /** RGB per texel, row by row. */
  values: Float32Array<ArrayBuffer>;
  /** Per texel 1 where it was read from a surface, else 0. */
  valid: Uint8Array<ArrayBuffer>;
}

export interface TileFrame {
  /** `LAST`, `REPLACE`, `HALF`. */
  flags: number;
  /** The version that pages have to have for the frame to fit. */
  base: number;
  version: number;
  /** Sizes of all pages at `version`. */
  pages: { width: number; height: number }[];
  tiles: Tile[];
}

/** All frames of the bytes of `atlasDeltas`. Throws where they end within one. */
export function readTiles(bytes: ArrayBuffer | Uint8Array): TileFrame[] {
  const all = bytes instanceof Uint8Array ? bytes : new Uint8Array(bytes);
  const frames: TileFrame[] = [];
  for (let at = 0; at < all.length; ) {
    if (all.length - at < HEADER) throw new Error('The tiles end within a frame.');
    const view = new DataView(all.buffer, all.byteOffset + at, all.length - at);
    if (view.getUint32(0, true) !== MAGIC || view.getUint16(4, true) !== 1) throw new Error('This is no frame of tiles.');
    const size = HEADER + view.getUint32(32, true);
    if (size > view.byteLength) throw new Error('The tiles end within a frame.');
    frames.push(decode(view, all.subarray(at + HEADER, at + size)));
    at += size;
  }
  return frames;
}

function decode(view: DataView, payload: Uint8Array): TileFrame {
  if (crc32(payload) !== view.getUint32(36, true)) throw new Error('A frame of tiles was damaged on its way.');
  const flags = view.getUint16(6, true);
  const [pageCount, tileCount] = [view.getUint32(24, true), view.getUint32(28, true)];
  const odd = () => new Error('A frame of tiles has an odd length.');
  if (PAGE * pageCount + TILE * tileCount > payload.length) throw odd();
  const table = new DataView(payload.buffer, payload.byteOffset, payload.length);
  const number = (at: number) => table.getUint32(at, true);
  const pages = Array.from({ length: pageCount }, (_, k) => ({ width: number(PAGE * k), height: number(PAGE * k + 4) }));
  if (pages.reduce((sum, { width, height }) => sum + width * height, 0) > MAX_TEXELS) throw new Error('The pages are larger than an atlas can be.');
  const places: Place[] = [];
  for (let at = PAGE * pageCount; places.length < tileCount; at += TILE) {
    const place = { page: number(at), x: number(at + 4), y: number(at + 8), width: number(at + 12), height: number(at + 16) };
    const page = pages[place.page];
    const fits = page && place.width > 0 && place.height > 0 && place.x + place.width <= page.width && place.y + place.height <= page.height;
    if (!fits) throw new Error('A tile does not lie on a page.');
    places.push(place);
  }
  const value = flags & HALF ? 6 : 12;
  let at = PAGE * pageCount + TILE * tileCount;
  let bitsAt = at + places.reduce((sum, { width, height }) => sum + value * width * height, 0);
  const end = bitsAt + places.reduce((sum, { width, height }) => sum + Math.ceil((width * height) / 8), 0);
  if (end !== payload.length) throw odd();
  const tiles = places.map((place) => {
    const texels = place.width * place.height;
    // Copied: typed arrays want aligned numbers. All machines that run browsers are little-endian.
    const copy = new Uint8Array(payload.subarray(at, at + value * texels)).buffer;
    const values = flags & HALF ? fromHalf(new Uint16Array(copy)) : new Float32Array(copy);
    const valid = new Uint8Array(texels);
    for (let k = 0; k < texels; k++) valid[k] = (payload[bitsAt + (k >> 3)]! >> (k & 7)) & 1;
    [at, bitsAt] = [at + value * texels, bitsAt + Math.ceil(texels / 8)];
    return { ...place, values, valid };
  });
  return { flags, base: Number(view.getBigUint64(8, true)), version: Number(view.getBigUint64(16, true)), pages, tiles };
}

/** A page as plain arrays, row by row from the top. */
export interface AtlasTexels {
  width: number;
  height: number;
  /** RGB per texel: irradiance / π, linear. */
  values: Float32Array<ArrayBuffer>;
  /** Per texel 1 where it was read from a surface; others are filled or empty. */
  valid: Uint8Array<ArrayBuffer>;
}

/** The pages of an atlas, which take the snapshots written into them. */
export class AtlasPages {
  pages: AtlasTexels[] = [];
  version = 0;

  /** Applies the frames of one snapshot or several; answers the rectangles that have new texels, for uploads of textures. New
   * pages, and those that grew, have other arrays than before. */
  apply(frames: TileFrame[]): Place[] {
    const changed: Place[] = [];
    let isFirst = true;
    for (const frame of frames) {
      if (isFirst && !(frame.flags & REPLACE) && frame.base !== this.version) {
        throw new Error(`A frame from version ${frame.base} for pages of version ${this.version}.`);
      }
      if (frame.flags & REPLACE) this.pages = [];
      isFirst = (frame.flags & LAST) !== 0;
      if (isFirst) this.version = frame.version;
      this.pages = frame.pages.map((size, k) => sized(this.pages[k], size));
      for (const tile of frame.tiles) write(this.pages[tile.page]!, tile);
      changed.push(...frame.tiles.map(({ page, x, y, width, height }) => ({ page, x, y, width, height })));
    }
    if (!isFirst) throw new Error('The last frame of a snapshot is missing.');
    return changed;
  }
}

function sized(old: AtlasTexels | undefined, { width, height }: { width: number; height: number }): AtlasTexels {
  if (old?.width === width && old.height === height) return old;
  const page = { width, height, values: new Float32Array(3 * width * height), valid: new Uint8Array(width * height) };
  if (old) {
    const common = { page: 0, x: 0, y: 0, width: Math.min(width, old.width), height: Math.min(height, old.height) };
    copyRows(old, page, common, 0);
  }
  return page;
}

const write = (page: AtlasTexels, tile: Tile) => copyRows(tile, page, tile, tile.y * page.width + tile.x);

/** Copies rows of a rectangle from the beginning of one array of texels to `start` in another. */
function copyRows(from: AtlasTexels | Tile, to: AtlasTexels, { width, height }: Place, start: number): void {
  for (let row = 0; row < height; row++) {
    const [source, target] = [row * from.width, start + row * to.width];
    to.values.set(from.values.subarray(3 * source, 3 * (source + width)), 3 * target);
    to.valid.set(from.valid.subarray(source, source + width), target);
  }
}
