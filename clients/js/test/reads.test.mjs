// Vertices that have the light of several elements.

import assert from 'node:assert/strict';
import { test } from 'node:test';
import { readVertices, readsOf } from '../dist/index.js';

/** What three.js has of a node whose meshes have these attributes. */
const node = (...meshes) => ({
  traverse: (visit) => [{}, ...meshes.map((attributes) => ({ geometry: { attributes } }))].forEach(visit),
});

test('vertices are means over what they read', () => {
  const reads = { elements: [0, 0, 0, 2, 0, 1, 1, 2, 2], weights: [1, 0, 0, 0.5, 0.25, 0.25, 0.75, 0.25, 0] };
  const light = Float32Array.from([4, 0, 8, 0, 4, 0, 2, 2, 2]);
  const vertices = new Float32Array(9);
  readVertices(reads, light, vertices);
  assert.deepEqual([...vertices], [4, 0, 8, 2, 2, 3, 0.5, 3.5, 0.5]);
});

test('an element of no weight does not count, whatever it holds', () => {
  const vertices = new Float32Array(3);
  readVertices({ elements: [0, 1, 1], weights: [1, 0, 0] }, Float32Array.from([1, 2, 3, NaN, Infinity, NaN]), vertices);
  assert.deepEqual([...vertices], [1, 2, 3]);
});

test('only meshes that say so share elements', () => {
  const [elements, weights] = [{ array: [0, 0, 0] }, { array: [1, 0, 0] }];
  assert.equal(readsOf(node({ position: { array: [] } })), undefined);
  assert.equal(readsOf(node({ _elements: elements })), undefined);
  assert.deepEqual(readsOf(node({}, { _elements: elements, _weights: weights })), { elements: [0, 0, 0], weights: [1, 0, 0] });
});
