// SSIM and FLIP of the page against libs/metrics', of pictures that differ much, little and not at all.
import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { mkdtempSync, rmSync, writeFileSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { after, before, test } from 'node:test';

const { SPLATBUS_WEB_TESTS: pages, SPLATBUS_PAGE_TRUTH: truth } = process.env;
const { flip, ssim, randomNumbers } = await import(join(pages, 'logic.js'));
const [kWidth, kHeight] = [53, 41]; // no side is the other
let folder;
before(() => (folder = mkdtempSync(join(tmpdir(), 'splatbus-metrics-'))));
after(() => rmSync(folder, { recursive: true, force: true }));

/** Edges, a gradient in color, and grain. */
function picture(shift, grain) {
  const random = randomNumbers(3);
  const rgba = new Uint8ClampedArray(4 * kWidth * kHeight);
  for (let y = 0; y < kHeight; ++y) {
    for (let x = 0; x < kWidth; ++x) {
      const inside = Math.hypot(x - 20 - shift, y - 17) < 11;
      const noise = () => grain * (random() - 0.5);
      rgba.set([inside ? 230 : 4 * x, inside ? 30 : 6 * y, (inside ? 90 : 255 - 3 * x) + noise(), 255].map((v, c) => (c < 3 ? v + noise() : v)), 4 * (y * kWidth + x));
    }
  }
  return rgba;
}

function truly(a, b) {
  const [fileA, fileB] = ['a', 'b'].map((name) => join(folder, name));
  writeFileSync(fileA, a);
  writeFileSync(fileB, b);
  return JSON.parse(execFileSync(truth, ['quality', fileA, fileB, kWidth, kHeight], { encoding: 'utf8' }));
}

for (const [name, changed] of [['nothing', picture(0, 0)], ['grain', picture(0, 12)], ['a disc that has moved', picture(5, 40)]]) {
  test(`${name} changes as much as libs/metrics says`, () => {
    const [a, b] = [changed, picture(0, 0)];
    const expected = truly(a, b);
    const ours = { ssim: ssim(a, b, kWidth, kHeight), flip: flip(a, b, kWidth, kHeight) };
    for (const key of ['ssim', 'flip']) assert.ok(Math.abs(ours[key] - expected[key]) < 2e-5, `${key}: ${ours[key]}, not ${expected[key]}`);
    if (name !== 'nothing') assert.ok(expected.flip > 0.005 && expected.ssim < 0.999, JSON.stringify(expected));
  });
}
