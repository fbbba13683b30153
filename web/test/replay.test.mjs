// Recorded streams, with insertions, removals, objects that move and light that changes, in both renderers: against what
// the native viewer draws of the same messages. One is shaded; of the other colors depend on where one looks from.
import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { copyFileSync, mkdirSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { after, before, test } from 'node:test';
import { launch, serve } from './browser.mjs';

const { SPLATBUS_WEB: site, SPLATBUS_WEB_TESTS: pages, SPLATBUS_PAGE_TRUTH: truth, SPLATBUS_LOGS: logs } = process.env;
const kLogs = ['long', 'radiance'];
let browser;
let server;
let root;
const views = {};
before(async () => {
  root = mkdtempSync(join(tmpdir(), 'splatbus-replay-'));
  for (const log of kLogs) {
    const folder = join(root, log);
    mkdirSync(folder);
    execFileSync(truth, ['render', join(logs, `${log}.log`), folder]);
    views[log] = JSON.parse(readFileSync(join(folder, 'views.json'), 'utf8'));
    copyFileSync(join(logs, `${log}.log`), join(root, `${log}.bin`));
  }
  server = await serve([pages, site, root]);
  browser = await launch();
});
after(async () => {
  await browser?.close();
  server?.close();
  if (process.env.SPLATBUS_WEB_PICTURES) execFileSync('cp', ['-r', `${root}/.`, process.env.SPLATBUS_WEB_PICTURES]);
  rmSync(root, { recursive: true, force: true });
});

for (const log of kLogs) {
  test(`after every message of ${log}.log the browser holds what the native viewer holds`, async () => {
    const page = await browser.newPage();
    await page.goto(`${server.url}/picture.html`);
    const expected = readFileSync(join(logs, `${log}.hashes`), 'utf8').trim().split('\n');
    assert.deepEqual(await page.evaluate((file) => window.tests.heldHashes(file), `${log}.bin`), expected);
    assert.ok(new Set(expected).size > expected.length / 2, 'the messages change something');
    await page.close();
  });
}

for (const api of ['webgl2', 'webgpu']) {
  for (const log of kLogs) {
    test(`${api} shows what the native viewer shows of ${log}.log`, async () => {
      const page = await browser.newPage();
      await page.goto(`${server.url}/picture.html`);
      const pictures = await page.evaluate(
        ([name, file, { times, poses }]) => window.tests.replay(name, file, times, poses),
        [api, `${log}.bin`, views[log]],
      );
      const folder = join(root, log);
      pictures.forEach((ofTime, time) =>
        ofTime.forEach((png, camera) => writeFileSync(join(folder, `${api}_${time}_${camera}.png`), Buffer.from(png, 'base64'))),
      );
      assert.equal(pictures.flat().length, 18);
      // It fails, and says by how much, where they differ.
      console.log(execFileSync(truth, ['compare', folder, api], { encoding: 'utf8' }).trim());
      await page.close();
    });
  }
}

test('a wall of screens is a camera, and no number is none', async () => {
  const page = await browser.newPage();
  await page.goto(`${server.url}/picture.html`);
  assert.deepEqual(await page.evaluate((sides) => window.tests.takesSides(sides), [1920, 16_000, 0, 100_000, NaN]), [true, true, false, false, false]);
  await page.close();
});
