// Pictures that browsers give as PNG: eight bits a channel, RGB or RGBA, not interlaced.
import { inflateSync } from 'node:zlib';

const kHeaderBytes = 8;

/** The predictor of PNG's fourth filter. */
function paeth(left, above, corner) {
  const guess = left + above - corner;
  const [toLeft, toAbove, toCorner] = [left, above, corner].map((value) => Math.abs(guess - value));
  return toLeft <= toAbove && toLeft <= toCorner ? left : toAbove <= toCorner ? above : corner;
}

/** { width, height, rgb }: [height][width][3], row 0 on top. */
export function readPng(bytes) {
  let [width, height, channels] = [0, 0, 0];
  const parts = [];
  for (let at = kHeaderBytes; at < bytes.length; ) {
    const length = bytes.readUInt32BE(at);
    const type = bytes.toString('latin1', at + 4, at + 8);
    const data = bytes.subarray(at + 8, at + 8 + length);
    if (type === 'IHDR') {
      [width, height] = [data.readUInt32BE(0), data.readUInt32BE(4)];
      channels = { 2: 3, 6: 4 }[data[9]];
      if (data[8] !== 8 || !channels || data[12] !== 0) throw new Error('a PNG of another kind');
    }
    if (type === 'IDAT') parts.push(data);
    at += 12 + length;
  }
  const raw = inflateSync(Buffer.concat(parts));
  const stride = channels * width;
  const rgb = new Uint8Array(3 * width * height);
  let above = new Uint8Array(stride);
  for (let y = 0; y < height; ++y) {
    const filter = raw[y * (stride + 1)];
    const row = Uint8Array.from(raw.subarray(y * (stride + 1) + 1, (y + 1) * (stride + 1)));
    for (let i = 0; i < stride; ++i) {
      const left = i < channels ? 0 : row[i - channels];
      const corner = i < channels ? 0 : above[i - channels];
      row[i] += [0, left, above[i], (left + above[i]) >> 1, paeth(left, above[i], corner)][filter];
    }
    for (let x = 0; x < width; ++x) rgb.set(row.subarray(channels * x, channels * x + 3), 3 * (y * width + x));
    above = row;
  }
  return { width, height, rgb };
}

/** How many colors a part of a picture has: one or two where there is nothing to see. */
export function colorsIn({ width, rgb }, box) {
  const colors = new Set();
  for (let y = box.y; y < box.y + box.height; ++y) {
    for (let x = box.x; x < box.x + box.width; ++x) {
      const at = 3 * (y * width + x);
      colors.add((rgb[at] << 16) | (rgb[at + 1] << 8) | rgb[at + 2]);
    }
  }
  return colors.size;
}
