// node test/measure.mjs: what docs/benchmarks.md says of the page, on the machine at hand, with the software GPU of headless
// Chromium. Takes the environment that ctest gives to the browser tests, and WRITE_LOGS, the program that writes a stream.
import { execFileSync } from 'node:child_process';
import { mkdtempSync, rmSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { launch, serve } from './browser.mjs';
import { startPipeline, until } from './pipeline.mjs';

const { SPLATBUS_WEB: site, SPLATBUS_WEB_TESTS: pages, SPLATBUS_BIN: bin } = process.env;
const say = (what, value) => console.log(`${what}: ${value}`);
const middle = (values) => values.sort((a, b) => a - b)[values.length >> 1];

const browser = await launch();
const folder = mkdtempSync(join(tmpdir(), 'splatbus-measure-'));
execFileSync(join(bin, 'write_logs'), [folder, '1000000']);
const server = await serve([pages, site, folder]);
try {
  const page = await browser.newPage();
  page.setDefaultTimeout(600_000);
  await page.goto(`${server.url}/picture.html`);
  for (const api of ['webgl2', 'webgpu']) {
    // Each in a page of its own: a canvas keeps its interface.
    await page.goto(`${server.url}/picture.html`);
    const ms = await page.evaluate((name) => window.tests.speed(name, 100_000, 256), api);
    say(`${api}, 100,000 Gaussians, 256 x 256, a frame and its way back`, `${ms.toFixed(0)} ms`);
  }
  const { sortMs, followerMb, sorterMb, mirrorMb, count } = await page.evaluate(() => window.tests.million('large.log'));
  say(`sort of ${count} Gaussians`, `${middle(sortMs).toFixed(1)} ms in the middle, ${Math.min(...sortMs).toFixed(1)} ms at best, of ${sortMs.length}`);
  say('memory of the stream worker', `${followerMb.toFixed(0)} MB for the model, ${mirrorMb.toFixed(0)} MB for the rows as they were handed on`);
  say('memory of the sort worker', `${sorterMb.toFixed(0)} MB`);
  await page.close();

  const kCapture = { input_cameras: 24, input_size: 128, sample_budget: 100000, reference_cameras: 8, reference_size: 160, reference_rate_hz: 2 };
  const pipeline = await startPipeline(kCapture);
  try {
    // The trainer's: a streamer without viewers follows nothing.
    await until(async () => ((await pipeline.status()).trainer?.gaussians ?? 0) >= 100_000);
    const firsts = [];
    for (let k = 0; k < 9; ++k) {
      const opened = await browser.newPage({ viewport: { width: 256, height: 256 } });
      opened.setDefaultTimeout(120_000);
      await opened.goto(pipeline.url);
      await opened.waitForFunction(() => window.splatbus?.firstPictureMs > 0);
      firsts.push(await opened.evaluate(() => window.splatbus.firstPictureMs));
      await opened.close();
    }
    const { gaussians } = (await pipeline.status()).trainer;
    const [first, ...others] = firsts;
    say(`first picture of a living model of ${gaussians}, while it is trained on the same cores`, `${first.toFixed(0)} ms of the first page, for which the streamer takes the model; then ${others.map((ms) => ms.toFixed(0)).join(', ')}, ${middle(others).toFixed(0)} ms in the middle`);
  } finally {
    await pipeline.close();
  }
} finally {
  await browser.close();
  server.close();
  rmSync(folder, { recursive: true, force: true });
}
