// Tiles as docs/delta-format.md lays them out, written apart from the code that reads them.

import assert from 'node:assert/strict';
import { test } from 'node:test';
import { AtlasPages, HALF, LAST, REPLACE, readTiles } from '../dist/index.js';
import { tiles } from './frame.mjs';

const tile = (page, x, y, width, height, values, valid) => ({ page, x, y, width, height, values, valid });

test('a frame has what was written', () => {
  const values = [1, 2, 3, 4, 5, 6, 0.25, -1, 1e30];
  const bytes = tiles({ flags: LAST, base: 3, version: 5, pages: [[8, 4], [2, 3]], tiles: [tile(1, 1, 0, 1, 3, values, [0b101])] });
  const [read, ...more] = readTiles(bytes);
  assert.equal(more.length, 0);
  assert.deepEqual([read.flags, read.base, read.version], [LAST, 3, 5]);
  assert.deepEqual(read.pages, [{ width: 8, height: 4 }, { width: 2, height: 3 }]);
  const { values: floats, valid, ...place } = read.tiles[0];
  assert.deepEqual(place, { page: 1, x: 1, y: 0, width: 1, height: 3 });
  assert.deepEqual([...floats], values.map(Math.fround));
  assert.deepEqual([...valid], [1, 0, 1]);
});

test('half precision is widened exactly', () => {
  const halves = [0x3c00, 0xc000, 0x7bff, 0x0001, 0x7c00, 0x3555];
  const bytes = tiles({ flags: LAST | HALF, base: 0, version: 1, pages: [[2, 1]], tiles: [tile(0, 0, 0, 2, 1, halves, [3])] });
  const [read] = readTiles(bytes);
  assert.deepEqual([...read.tiles[0].values], [1, -2, 65504, 2 ** -24, Infinity, 1365 / 4096].map(Math.fround));
});

test('pages take snapshots, grow, and go', () => {
  const pages = new AtlasPages();
  const at = (page, x, y) => [...pages.pages[page].values.subarray(3 * (y * pages.pages[page].width + x)).subarray(0, 3)];
  const first = tiles({ flags: REPLACE, base: 0, version: 1, pages: [[2, 2]], tiles: [tile(0, 1, 0, 1, 2, [1, 2, 3, 4, 5, 6], [2])] });
  const end = tiles({ flags: LAST, base: 0, version: 1, pages: [[2, 2]], tiles: [] });
  assert.deepEqual(pages.apply(readTiles(Buffer.concat([first, end]))), [{ page: 0, x: 1, y: 0, width: 1, height: 2 }]);
  assert.deepEqual([at(0, 0, 0), at(0, 1, 0), at(0, 1, 1)], [[0, 0, 0], [1, 2, 3], [4, 5, 6]]);
  assert.deepEqual([...pages.pages[0].valid], [0, 0, 0, 1]);
  const more = tiles({ flags: LAST, base: 1, version: 2, pages: [[3, 2], [1, 1]], tiles: [tile(0, 2, 1, 1, 1, [7, 8, 9], [1])] });
  pages.apply(readTiles(more));
  assert.deepEqual([at(0, 1, 0), at(0, 1, 1), at(0, 2, 0), at(0, 2, 1), at(1, 0, 0)], [[1, 2, 3], [4, 5, 6], [0, 0, 0], [7, 8, 9], [0, 0, 0]]);
  assert.throws(() => pages.apply(readTiles(more).map((frame) => ({ ...frame, version: 3 }))), /from version 1/);
  assert.throws(() => new AtlasPages().apply(readTiles(first)), /last frame/);
  const anew = (flags) => readTiles(tiles({ flags, base: 0, version: 9, pages: [[1, 1]], tiles: [] }))[0];
  pages.apply([anew(REPLACE), anew(0), anew(LAST)]);
  assert.deepEqual([pages.version, pages.pages.length, at(0, 0, 0)], [9, 1, [0, 0, 0]]);
});

test('what is damaged, cut short or off the page is refused', () => {
  const good = tiles({ flags: LAST, base: 0, version: 1, pages: [[2, 2]], tiles: [tile(0, 0, 0, 1, 1, [1, 2, 3], [1])] });
  const broken = (at, value) => {
    const copy = Buffer.from(good);
    copy[at] = value;
    return copy;
  };
  assert.throws(() => readTiles(broken(50, 99)), /damaged/);
  assert.throws(() => readTiles(broken(3, 68)), /no frame of tiles/);
  assert.throws(() => readTiles(broken(4, 2)), /no frame of tiles/);
  assert.throws(() => readTiles(broken(24, 200)), /odd length/);
  assert.throws(() => readTiles(good.subarray(0, good.length - 1)), /within a frame/);
  assert.throws(() => readTiles(good.subarray(0, 20)), /within a frame/);
  const placed = (...place) => tiles({ flags: LAST, base: 0, version: 1, pages: [[2, 2]], tiles: [tile(...place, [], [])] });
  for (const place of [[1, 0, 0, 1, 1], [0, 2, 0, 1, 1], [0, 0, 1, 1, 2], [0, 0, 0, 0, 1]]) {
    assert.throws(() => readTiles(placed(...place)), /not lie on a page/);
  }
  assert.throws(() => readTiles(placed(0, 0, 0, 2, 2)), /odd length/);
  assert.throws(() => readTiles(tiles({ flags: LAST, base: 0, version: 1, pages: [[1 << 15, 1 << 15]], tiles: [] })), /larger/);
});
