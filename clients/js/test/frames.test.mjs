// Frames as docs/delta-format.md lays them out, written apart from the code that reads them.

import assert from 'node:assert/strict';
import { test } from 'node:test';
import { ElementMap, FrameReader, HALF, LAST, REPLACE, readFrames } from '../dist/index.js';
import { crc32, frame } from './frame.mjs';

test('the reference CRC is the one of the format', () => {
  assert.equal(crc32(Buffer.from('123456789')), 0xcbf43926);
});

test('a frame has what was written', () => {
  const bytes = frame({ flags: LAST, base: 3, version: 5, runs: [[1, 2], [7, 1]], values: [1, 2, 3, 4, 5, 6, 0.25, -1, 1e30] });
  const [read] = readFrames(bytes);
  assert.equal(read.flags, LAST);
  assert.equal(read.base, 3);
  assert.equal(read.version, 5);
  assert.deepEqual([...read.runs], [1, 2, 7, 1]);
  assert.deepEqual([...read.values], [1, 2, 3, 4, 5, 6, 0.25, -1, Math.fround(1e30)]);
});

test('half precision is widened exactly', () => {
  const halves = [0x3c00, 0xc000, 0x7bff, 0x0001, 0x7c00, 0x3555];
  const [read] = readFrames(frame({ flags: LAST | HALF, base: 0, version: 1, runs: [[0, 2]], values: halves }));
  assert.deepEqual([...read.values], [1, -2, 65504, 2 ** -24, Infinity, 1365 / 4096].map(Math.fround));
});

test('frames are read from chunks of any size', () => {
  const bytes = Buffer.concat([
    frame({ flags: 0, base: 0, version: 1, runs: [[0, 1]], values: [1, 1, 1] }),
    frame({ flags: LAST, base: 0, version: 1, runs: [], values: [] }),
    frame({ flags: LAST, base: 1, version: 2, runs: [[4, 1]], values: [2, 2, 2] }),
  ]);
  for (let size = 1; size <= bytes.length; size += 7) {
    const reader = new FrameReader();
    const frames = [];
    for (let at = 0; at < bytes.length; at += size) frames.push(...reader.push(bytes.subarray(at, at + size)));
    assert.deepEqual(frames.map((f) => [f.flags, f.version, f.values.length]), [[0, 1, 3], [LAST, 1, 0], [LAST, 2, 3]]);
    assert.equal(reader.isInside, false);
  }
});

test('what is damaged, cut short or of another format is refused', () => {
  const good = frame({ flags: LAST, base: 0, version: 1, runs: [[0, 1]], values: [1, 2, 3] });
  const broken = (at, value) => {
    const copy = Buffer.from(good);
    copy[at] = value;
    return copy;
  };
  assert.throws(() => readFrames(broken(50, 99)), /damaged/);
  assert.throws(() => readFrames(broken(0, 0)), /no delta frame/);
  assert.throws(() => readFrames(broken(4, 2)), /no delta frame/);
  assert.throws(() => readFrames(broken(24, 2)), /odd length/);
  assert.throws(() => readFrames(good.subarray(0, good.length - 1)), /within a frame/);
  assert.throws(() => readFrames(frame({ flags: LAST, base: 0, version: 1, runs: [[0, 2]], values: [1, 2, 3] })), /do not fit/);
});

test('a map takes snapshots, grows, and is emptied where a frame says so', () => {
  const map = new ElementMap();
  const first = readFrames(frame({ flags: LAST | REPLACE, base: 0, version: 1, runs: [[0, 2]], values: [1, 1, 1, 2, 2, 2] }));
  assert.deepEqual(map.apply(first), [[0, 2]]);
  map.apply(readFrames(frame({ flags: LAST, base: 1, version: 2, runs: [[1, 2]], values: [5, 5, 5, 6, 6, 6] })));
  assert.deepEqual([...map.values], [1, 1, 1, 5, 5, 5, 6, 6, 6]);
  assert.equal(map.version, 2);
  const again = readFrames(frame({ flags: LAST | REPLACE, base: 0, version: 3, runs: [[0, 1]], values: [9, 9, 9] }));
  assert.deepEqual(map.apply(again), [[0, 3]]);
  assert.deepEqual([...map.values], [9, 9, 9, 0, 0, 0, 0, 0, 0]);
});
