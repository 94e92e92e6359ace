// Writes frames as docs/delta-format.md has them, apart from the code that reads them.

/** CRC-32 (IEEE), bit by bit. */
export function crc32(bytes) {
  let crc = 0xffffffffn;
  for (const byte of bytes) {
    crc ^= BigInt(byte);
    for (let k = 0; k < 8; k++) crc = crc & 1n ? (crc >> 1n) ^ 0xedb88320n : crc >> 1n;
  }
  return Number(crc ^ 0xffffffffn);
}

/** `values`: numbers, or with flag bit 2 the bits of halves. */
export function frame({ flags, base, version, runs, values }) {
  const isHalf = (flags & 4) !== 0;
  const payload = Buffer.alloc(8 * runs.length + values.length * (isHalf ? 2 : 4));
  runs.forEach(([first, count], i) => {
    payload.writeUInt32LE(first, 8 * i);
    payload.writeUInt32LE(count, 8 * i + 4);
  });
  values.forEach((value, i) => {
    if (isHalf) payload.writeUInt16LE(value, 8 * runs.length + 2 * i);
    else payload.writeFloatLE(value, 8 * runs.length + 4 * i);
  });
  return sealed('RBKD', { flags, base, version }, [runs.length, values.length / 3], payload);
}

/** Tiles: `values` as above and bytes of validity each; `pages`: widths and heights. */
export function tiles({ flags, base, version, pages, tiles }) {
  const u32 = (numbers) => Buffer.from(Uint32Array.from(numbers).buffer);
  const number = (value) => (flags & 4 ? Buffer.from(Uint16Array.of(value).buffer) : Buffer.from(Float32Array.of(value).buffer));
  const payload = Buffer.concat([
    ...pages.map(u32),
    ...tiles.map(({ page, x, y, width, height }) => u32([page, x, y, width, height])),
    ...tiles.flatMap(({ values }) => values.map(number)),
    ...tiles.map(({ valid }) => Buffer.from(valid)),
  ]);
  return sealed('RBKT', { flags, base, version }, [pages.length, tiles.length], payload);
}

function sealed(letters, { flags, base, version }, counts, payload) {
  const header = Buffer.alloc(40);
  header.write(letters, 0, 'latin1');
  header.writeUInt16LE(1, 4);
  header.writeUInt16LE(flags, 6);
  header.writeBigUInt64LE(BigInt(base), 8);
  header.writeBigUInt64LE(BigInt(version), 16);
  counts.forEach((count, i) => header.writeUInt32LE(count, 24 + 4 * i));
  header.writeUInt32LE(payload.length, 32);
  header.writeUInt32LE(crc32(payload), 36);
  return Buffer.concat([header, payload]);
}
