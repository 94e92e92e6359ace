// Pictures and what they show.

import { inflateSync } from 'node:zlib';

/** 8-bit pixels of a PNG, as the browser and the service write them. */
export function decodePng(bytes) {
  const [width, height, channels] = [bytes.readUInt32BE(16), bytes.readUInt32BE(20), bytes[25] === 6 ? 4 : 3];
  const data = [];
  for (let at = 8; at < bytes.length; at += bytes.readUInt32BE(at) + 12) {
    if (bytes.toString('latin1', at + 4, at + 8) === 'IDAT') data.push(bytes.subarray(at + 8, at + 8 + bytes.readUInt32BE(at)));
  }
  const raw = inflateSync(Buffer.concat(data));
  const stride = width * channels;
  const rows = Buffer.alloc(stride * height);
  for (let y = 0; y < height; y++) {
    const filter = raw[y * (stride + 1)];
    for (let x = 0; x < stride; x++) {
      const left = x >= channels ? rows[y * stride + x - channels] : 0;
      const up = y ? rows[(y - 1) * stride + x] : 0;
      const corner = x >= channels && y ? rows[(y - 1) * stride + x - channels] : 0;
      const p = left + up - corner;
      const [a, b, c] = [Math.abs(p - left), Math.abs(p - up), Math.abs(p - corner)];
      const paeth = a <= b && a <= c ? left : b <= c ? up : corner;
      const predicted = [0, left, up, (left + up) >> 1, paeth][filter];
      rows[y * stride + x] = raw[y * (stride + 1) + 1 + x] + predicted;
    }
  }
  return { width, height, at: (x, y) => [...rows.subarray(y * stride + x * channels, y * stride + x * channels + 3)] };
}

/** Mean of the three channels over a square around a point given in parts of the picture. */
export function patch(picture, [u, v], half = 4) {
  const [cx, cy] = [Math.round(u * picture.width), Math.round(v * picture.height)];
  let [sum, count] = [0, 0];
  for (let y = cy - half; y <= cy + half; y++) {
    for (let x = cx - half; x <= cx + half; x++) {
      sum += picture.at(x, y).reduce((a, b) => a + b) / 3;
      count++;
    }
  }
  return sum / count;
}

/** The median over a grid of the difference of two pictures of one size, of 255. */
export function difference(one, other) {
  const differences = [];
  for (let v = 0.05; v < 1; v += 0.09) {
    for (let u = 0.05; u < 1; u += 0.06) differences.push(Math.abs(patch(one, [u, v], 2) - patch(other, [u, v], 2)));
  }
  return differences.sort((a, b) => a - b)[Math.floor(differences.length / 2)];
}
