// node test/measure.mjs [outages]: what docs/benchmarks.md says of the page, on the machine at hand, with the software GPU of headless
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

/** When a page has what the service that was killed gives, and all of the model; `then`: the stream before, and the scene just after. */
const kBack = {
  gateway: (then) => window.wasAway && window.splatbus.connection === 'open' && window.splatbus.figures.missing === 0 && window.splatbus.figures.sceneVersion > then.sceneVersion,
  streamer: (then) => window.splatbus.figures.epoch !== then.epoch && window.splatbus.figures.missing === 0,
  engine: (then) => window.splatbus.figures.sceneVersion > then.sceneVersion && window.splatbus.figures.missing === 0,
  trainer: () => window.splatbus.figures.missing === 0,
};

/** How long that takes, and how much of the picture is there meanwhile: a PNG of nothing has hardly any bytes. */
async function sayOutage(pipeline, source, isBack) {
  const page = await browser.newPage({ viewport: { width: 256, height: 256 } });
  page.setDefaultTimeout(120_000);
  await page.goto(pipeline.url);
  await page.waitForFunction(() => window.splatbus?.firstPictureMs > 0 && window.splatbus.figures?.missing === 0);
  await page.evaluate(() => {
    setInterval(() => (window.wasAway ||= window.splatbus.connection !== 'open'), 10);
  });
  const whole = (await page.screenshot()).length;
  const { epoch } = await page.evaluate(() => window.splatbus.figures);
  const lives = await pipeline.kill(source);
  const start = performance.now();
  // Of what is on its way from the one that was killed nothing counts.
  await new Promise((resolve) => setTimeout(resolve, 100));
  const before = { epoch, sceneVersion: await page.evaluate(() => window.splatbus.figures.sceneVersion) };
  const seconds = () => ((performance.now() - start) / 1000).toFixed(1);
  let backAfter = null;
  const back = lives().then(async () => {
    const livesAfter = seconds();
    await page.waitForFunction(isBack, before, { polling: 20 });
    backAfter = `whole again after ${seconds()} s, ${livesAfter} of which until another one lived`;
  });
  let least = whole;
  while (backAfter === null) {
    least = Math.min(least, (await page.screenshot()).length);
    await new Promise((resolve) => setTimeout(resolve, 500)); // pictures are made on the same cores
  }
  await back;
  say(`${source} killed`, `${backAfter}; the least picture meanwhile has ${((100 * least) / whole).toFixed(0)} % of the bytes of the one before`);
  await page.close();
}

async function sayPictures() {
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
}

async function sayFirstPictures(pipeline) {
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
}

const browser = await launch();
const folder = mkdtempSync(join(tmpdir(), 'splatbus-measure-'));
const outagesAlone = process.argv[2] === 'outages';
if (!outagesAlone) execFileSync(join(bin, 'write_logs'), [folder, '1000000']);
const server = await serve([pages, site, folder]);
try {
  if (!outagesAlone) await sayPictures();

  const kCapture = { input_cameras: 24, input_size: 128, sample_budget: 100000, reference_cameras: 8, reference_size: 160, reference_rate_hz: 2 };
  const pipeline = await startPipeline(kCapture);
  try {
    // The trainer's: a streamer without viewers follows nothing.
    await until(async () => ((await pipeline.status()).trainer?.gaussians ?? 0) >= 100_000);
    if (!outagesAlone) await sayFirstPictures(pipeline);
    for (const [source, isBack] of Object.entries(kBack)) await sayOutage(pipeline, source, isBack);
  } finally {
    await pipeline.close();
  }
} finally {
  await browser.close();
  server.close();
  rmSync(folder, { recursive: true, force: true });
}
