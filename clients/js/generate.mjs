// Writes TypeScript types for what the API's description calls schemas, with their descriptions as comments:
//
//   node generate.mjs ../../openapi/openapi.json src/openapi.ts
//
// test/openapi.test.mjs holds the committed file against it, so it needs no package.

import { readFileSync, writeFileSync } from 'node:fs';
import { fileURLToPath } from 'node:url';

const SCALARS = { string: 'string', integer: 'number', number: 'number', boolean: 'boolean', null: 'null' };

/** The text of the file for a description. */
export function generate(description) {
  const schemas = Object.entries(description.components.schemas).sort(([a], [b]) => (a < b ? -1 : 1));
  const parts = schemas.map(([name, schema]) => {
    const isInterface = schema.type === 'object' && schema.properties;
    return comment(schema.description, '') + (isInterface ? `export interface ${name} ${type(schema, '')}\n` : `export type ${name} = ${type(schema, '')};\n`);
  });
  return `// Made from openapi/openapi.json by generate.mjs: \`npm run types\`. Not to be edited.\n\n${parts.join('\n')}`;
}

/** The type of a schema. */
function type(schema, indent) {
  if (schema.$ref) return schema.$ref.split('/').at(-1);
  const several = schema.oneOf ?? schema.anyOf;
  if (several) return several.map((one) => type(one, indent)).join(' | ');
  if (schema.allOf) return schema.allOf.map((one) => type(one, indent)).join(' & ');
  if (schema.enum) return schema.enum.map((value) => JSON.stringify(value)).join(' | ');
  if (Array.isArray(schema.type)) return schema.type.map((one) => type({ ...schema, type: one }, indent)).join(' | ');
  if (schema.type === 'array') return list(schema, indent);
  if (schema.type === 'object' && schema.properties) return members(schema, indent);
  if (schema.type === 'object') return `Record<string, ${schema.additionalProperties?.type ? type(schema.additionalProperties, indent) : 'unknown'}>`;
  return SCALARS[schema.type] ?? 'unknown';
}

function list({ items, minItems, maxItems }, indent) {
  const item = items ? type(items, indent) : 'unknown';
  if (minItems === maxItems && minItems > 1 && minItems < 5) return `[${Array(minItems).fill(item).join(', ')}]`;
  return /[ |&]/.test(item) ? `(${item})[]` : `${item}[]`;
}

function members({ properties, required = [] }, indent) {
  const inner = `${indent}  `;
  const lines = Object.entries(properties).map(([name, schema]) => {
    const isOptional = required.includes(name) ? '' : '?';
    return `${comment(schema.description, inner)}${inner}${name}${isOptional}: ${type(schema, inner)};\n`;
  });
  return `{\n${lines.join('')}${indent}}`;
}

function comment(text, indent) {
  if (!text) return '';
  const lines = text.trim().replaceAll('*/', '* /').split('\n');
  if (lines.length === 1) return `${indent}/** ${lines[0]} */\n`;
  return `${indent}/**\n${lines.map((line) => `${indent} * ${line}`.trimEnd() + '\n').join('')}${indent} */\n`;
}

if (process.argv[1] === fileURLToPath(import.meta.url)) {
  const [from, to] = process.argv.slice(2);
  writeFileSync(to, generate(JSON.parse(readFileSync(from, 'utf8'))));
}
