// The delta format, version 1: frames of changed values, little-endian.

const MAGIC = 0x444b4252; // "RBKD"
const HEADER = 40;

export const LAST = 1;
export const REPLACE = 2;

export interface Frame {
  flags: number;
  version: number;
  /** First element and count, run after run. */
  runs: Uint32Array<ArrayBuffer>;
  /** RGB per value, in run order. */
  values: Float32Array<ArrayBuffer>;
}

const CRC = new Uint32Array(256).map((_, n) => {
  for (let k = 0; k < 8; k++) n = n & 1 ? 0xedb88320 ^ (n >>> 1) : n >>> 1;
  return n;
});

function crc32(bytes: Uint8Array): number {
  let crc = 0xffffffff;
  for (let i = 0; i < bytes.length; i++) crc = CRC[(crc ^ bytes[i]!) & 255]! ^ (crc >>> 8);
  return (crc ^ 0xffffffff) >>> 0;
}

/** Cuts a stream of bytes into frames. */
export class FrameReader {
  private chunks: Uint8Array[] = [];
  private length = 0;
  private wanted = HEADER;

  /** Takes bytes; answers the frames that are complete with them. */
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

function decode(view: DataView, payload: Uint8Array): Frame {
  const [runs, values] = [view.getUint32(24, true), view.getUint32(28, true)];
  if (crc32(payload) !== view.getUint32(36, true)) throw new Error('A delta frame was damaged on its way.');
  // Copied: typed arrays want aligned numbers. All machines that run browsers are little-endian.
  const copy = payload.slice().buffer;
  return {
    flags: view.getUint16(6, true),
    version: Number(view.getBigUint64(16, true)),
    runs: new Uint32Array(copy, 0, 2 * runs),
    values: new Float32Array(copy, 8 * runs, 3 * values),
  };
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
