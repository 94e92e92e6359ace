// The delta format, version 1: frames of changed values, little-endian (docs/delta-format.md).

const MAGIC = 0x444b4252; // "RBKD"
const HEADER = 40;

/** Flags of a frame: it is the last of its snapshot; the map is emptied first; values are of half precision. */
export const LAST = 1;
export const REPLACE = 2;
export const HALF = 4;

export interface Frame {
  flags: number;
  /** The version that a map has to have for the frame to fit. */
  base: number;
  version: number;
  /** First element and count, run after run. */
  runs: Uint32Array<ArrayBuffer>;
  /** New values (not differences), RGB per value, in run order. */
  values: Float32Array<ArrayBuffer>;
}

const CRC = new Uint32Array(256).map((_, n) => {
  for (let k = 0; k < 8; k++) n = n & 1 ? 0xedb88320 ^ (n >>> 1) : n >>> 1;
  return n;
});

/** CRC-32 (IEEE). */
export function crc32(bytes: Uint8Array): number {
  let crc = 0xffffffff;
  for (let i = 0; i < bytes.length; i++) crc = CRC[(crc ^ bytes[i]!) & 255]! ^ (crc >>> 8);
  return (crc ^ 0xffffffff) >>> 0;
}

/** Cuts a stream of bytes into frames. */
export class FrameReader {
  private chunks: Uint8Array[] = [];
  private length = 0;
  private wanted = HEADER;

  /** Whether a frame has begun that is not complete. */
  get isInside(): boolean {
    return this.length > 0;
  }

  /** Takes bytes; answers the frames that are complete with them. Throws at bytes that are no frames. */
  push(chunk: Uint8Array): Frame[] {
    this.chunks.push(chunk);
    this.length += chunk.length;
    const frames: Frame[] = [];
    while (this.length >= this.wanted) {
      const bytes = this.join();
      const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.length);
      if (view.getUint32(0, true) !== MAGIC || view.getUint16(4, true) !== 1) throw new Error('This is no delta frame.');
      const size = HEADER + view.getUint32(32, true);
      if (bytes.length < size) {
        this.wanted = size;
        break;
      }
      frames.push(decode(view, bytes.subarray(HEADER, size)));
      this.chunks = [bytes.subarray(size)];
      this.length = bytes.length - size;
      this.wanted = HEADER;
    }
    return frames;
  }

  private join(): Uint8Array {
    if (this.chunks.length > 1) {
      const all = new Uint8Array(this.length);
      let at = 0;
      for (const chunk of this.chunks) {
        all.set(chunk, at);
        at += chunk.length;
      }
      this.chunks = [all];
    }
    return this.chunks[0] ?? new Uint8Array();
  }
}

/** All frames of some bytes. Throws where they end within one. */
export function readFrames(bytes: ArrayBuffer | Uint8Array): Frame[] {
  const reader = new FrameReader();
  const frames = reader.push(bytes instanceof Uint8Array ? bytes : new Uint8Array(bytes));
  if (reader.isInside) throw new Error('The delta ends within a frame.');
  return frames;
}

function decode(view: DataView, payload: Uint8Array): Frame {
  const flags = view.getUint16(6, true);
  const [runs, values] = [view.getUint32(24, true), view.getUint32(28, true)];
  if (crc32(payload) !== view.getUint32(36, true)) throw new Error('A delta frame was damaged on its way.');
  if (payload.length !== 8 * runs + (flags & HALF ? 6 : 12) * values) throw new Error('A delta frame has an odd length.');
  // Copied: typed arrays want aligned numbers. All machines that run browsers are little-endian.
  const copy = new Uint8Array(payload).buffer;
  const frame = {
    flags,
    base: Number(view.getBigUint64(8, true)),
    version: Number(view.getBigUint64(16, true)),
    runs: new Uint32Array(copy, 0, 2 * runs),
    values: flags & HALF ? fromHalf(new Uint16Array(copy, 8 * runs)) : new Float32Array(copy, 8 * runs, 3 * values),
  };
  let named = 0;
  for (let i = 1; i < frame.runs.length; i += 2) named += frame.runs[i]!;
  if (named !== values) throw new Error('The runs of a delta frame do not fit its values.');
  return frame;
}

/** Widens numbers of half precision, exactly. */
export function fromHalf(bits: Uint16Array): Float32Array<ArrayBuffer> {
  const values = new Float32Array(bits.length);
  bits.forEach((half, i) => {
    const [exponent, fraction] = [(half >> 10) & 31, half & 1023];
    const size = exponent === 31 ? (fraction ? NaN : Infinity)
      : exponent ? 2 ** (exponent - 15) * (1 + fraction / 1024) : 2 ** -14 * (fraction / 1024);
    values[i] = half & 0x8000 ? -size : size;
  });
  return values;
}

/** Writes a frame into a map; answers the ranges that changed. A map that is too short is an error of the caller's. */
export function apply(frame: Frame, map: Float32Array): [first: number, count: number][] {
  const ranges: [number, number][] = [];
  if (frame.flags & REPLACE) map.fill(0);
  let from = 0;
  for (let i = 0; i < frame.runs.length; i += 2) {
    const [first, count] = [frame.runs[i]!, frame.runs[i + 1]!];
    map.set(frame.values.subarray(3 * from, 3 * (from + count)), 3 * first);
    from += count;
    ranges.push([first, count]);
  }
  return ranges;
}

/** One past the last element that a frame names. */
export function reach(frame: Frame): number {
  let end = 0;
  for (let i = 0; i < frame.runs.length; i += 2) end = Math.max(end, frame.runs[i]! + frame.runs[i + 1]!);
  return end;
}

/** A light map as a plain array, RGB per element, that grows with the snapshots written into it. */
export class ElementMap {
  values = new Float32Array();
  version = 0;

  /** Room for so many elements; new ones are black. Answers whether `values` is another array now. */
  grow(elements: number): boolean {
    if (3 * elements <= this.values.length) return false;
    const larger = new Float32Array(3 * elements);
    larger.set(this.values);
    this.values = larger;
    return true;
  }

  /** Applies the frames of a whole snapshot; answers the ranges that changed. */
  apply(frames: Frame[]): [first: number, count: number][] {
    this.grow(Math.max(0, ...frames.map(reach)));
    const ranges = frames.flatMap((frame) => {
      const named = apply(frame, this.values);
      return frame.flags & REPLACE ? [[0, this.values.length / 3] as [number, number]] : named;
    });
    this.version = frames.at(-1)?.version ?? this.version;
    return ranges;
  }
}
