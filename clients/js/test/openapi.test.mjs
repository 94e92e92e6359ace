// The committed types are those of the committed description.

import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';
import { test } from 'node:test';
import { generate } from '../generate.mjs';

const read = (path) => readFileSync(new URL(path, import.meta.url), 'utf8');

test('src/openapi.ts is what the description says: `npm run types` in clients/js writes it again', () => {
  assert.equal(read('../src/openapi.ts'), generate(JSON.parse(read('../../../openapi/openapi.json'))));
});

test('types are made of what schemas use', () => {
  const schemas = {
    Point: { type: 'array', items: { type: 'number' }, minItems: 3, maxItems: 3 },
    Kind: { type: 'string', enum: ['a', 'b'], description: 'What it is.' },
    Thing: {
      type: 'object',
      required: ['at'],
      properties: {
        at: { $ref: '#/components/schemas/Point' },
        of: { oneOf: [{ $ref: '#/components/schemas/Kind' }, { type: 'null' }] },
        parts: { type: ['array', 'null'], items: { type: 'string' } },
      },
    },
  };
  const text = generate({ components: { schemas } });
  assert.match(text, /export type Point = \[number, number, number\];/);
  assert.match(text, /\/\*\* What it is. \*\/\nexport type Kind = "a" \| "b";/);
  assert.match(text, /export interface Thing \{\n {2}at: Point;\n {2}of\?: Kind \| null;\n {2}parts\?: string\[\] \| null;\n\}/);
});
