// A recorded stream, with insertions, removals, objects that move and light that changes, in both renderers: against what
// the native viewer draws of the same messages.
import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { copyFileSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { after, before, test } from 'node:test';
import { launch, serve } from './browser.mjs';

const { SPLATBUS_WEB: site, SPLATBUS_WEB_TESTS: pages, SPLATBUS_PAGE_TRUTH: truth, SPLATBUS_LOG: log } = process.env;
let browser;
let server;
let folder;
let views;
before(async () => {
  folder = mkdtempSync(join(tmpdir(), 'splatbus-replay-'));
  execFileSync(truth, ['render', log, folder]);
  views = JSON.parse(readFileSync(join(folder, 'views.json'), 'utf8'));
  copyFileSync(log, join(folder, 'stream.bin'));
  server = await serve([pages, site, folder]);
  browser = await launch();
});
after(async () => {
  await browser?.close();
  server?.close();
  rmSync(folder, { recursive: true, force: true });
});

for (const api of ['webgl2', 'webgpu']) {
  test(`${api} shows what the native viewer shows`, async () => {
    const page = await browser.newPage();
    await page.goto(`${server.url}/picture.html`);
    const pictures = await page.evaluate(
      ([name, { times, poses }]) => window.tests.replay(name, 'stream.bin', times, poses),
      [api, views],
    );
    pictures.forEach((ofTime, time) =>
      ofTime.forEach((png, camera) => writeFileSync(join(folder, `${api}_${time}_${camera}.png`), Buffer.from(png, 'base64'))),
    );
    assert.equal(pictures.flat().length, 18);
    if (process.env.SPLATBUS_WEB_PICTURES) execFileSync('cp', ['-r', `${folder}/.`, process.env.SPLATBUS_WEB_PICTURES]);
    // It fails, and says by how much, where they differ.
    console.log(execFileSync(truth, ['compare', folder, api], { encoding: 'utf8' }).trim());
    await page.close();
  });
}
