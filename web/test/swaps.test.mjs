// The page while services are swapped: its own loop goes on as before, and so does the picture.
import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { filmed, launch } from './browser.mjs';
import { startPipeline } from './pipeline.mjs';
import { colorsIn, readPng } from './png.mjs';

const kCapture = { input_cameras: 8, input_size: 64, sample_budget: 4000, reference_cameras: 4, reference_size: 64, reference_rate_hz: 1 };
/** Of the page's 320 x 200 pixels, those that no words cover. */
const kMiddle = { x: 60, y: 40, width: 200, height: 80 };
const kBeforeMs = 6000;
const kRestMs = 2000;
/**
 * What is measured between swaps is of this run and machine. A swap starts a process on the same two processors, by which the page draws, too, and
 * through another gateway a page asks what it lacks: all turns then take longer. A loop that waits has a longest turn, not a median.
 */
const kSlower = 3;
const kLongerMs = 500;
/** How to wait in the page: by its frames, as it is done by default, would count as turns of its loop. */
const kPolls = { polling: 100 };
/** On a busy machine any page is late now and then; one that waits for what is swapped is late every time. */
const kTimes = 3;
let browser;
let pipeline;
let page;
const errors = [];

before(async () => {
  pipeline = await startPipeline(kCapture);
  browser = await launch();
  page = await browser.newPage({ viewport: { width: 320, height: 200 } });
  page.setDefaultTimeout(60_000);
  page.on('pageerror', (error) => errors.push(String(error)));
  await page.addInitScript(() => {
    const ask = window.requestAnimationFrame.bind(window);
    window.turns = []; // when each of the page's loop began
    window.requestAnimationFrame = (turn) =>
      ask((nowMs) => {
        window.turns.push(performance.now());
        turn(nowMs);
      });
  });
});
after(async () => {
  await browser?.close();
  await pipeline?.close();
});

const figures = () => page.evaluate(() => window.splatbus.figures);
const median = (values) => [...values].sort((a, b) => a - b)[values.length >> 1];

/**
 * Does `act`; between turns of the page's loop meanwhile, in milliseconds, and the colors of the emptiest picture that the
 * browser showed. That is the one of the fewest bytes: to decode all of them would take longer than the test.
 */
async function watched(act) {
  const film = await filmed(page);
  await page.evaluate(() => (window.turns = [performance.now()]));
  await act();
  const turns = await page.evaluate(() => [...window.turns, performance.now()]);
  const [emptiest] = (await film()).sort((a, b) => a.length - b.length);
  const colors = colorsIn(readPng(emptiest), kMiddle);
  return { intervals: turns.slice(1).map((atMs, i) => atMs - turns[i]), colors };
}
const rested = () => watched(() => new Promise((resolve) => setTimeout(resolve, kRestMs)));
const swapped = (service) =>
  watched(async () => {
    await pipeline.swap(service);
    const then = await figures();
    await page.waitForFunction((before) => {
      const { figures: now, connection } = window.splatbus;
      return connection === 'open' && now.missing === 0 && now.bytes > before.bytes && now.sceneVersion > before.sceneVersion;
    }, then, kPolls);
    // A turn that waits has not come yet.
    const turned = await page.evaluate(() => window.turns.length);
    await page.waitForFunction((count) => window.turns.length > count, turned + 10, kPolls);
  });

test('whatever is swapped, the page\'s loop and picture go on as before', async (t) => {
  await page.goto(`${pipeline.url}/#view=0,0,0.3,0.8,0.5,4`);
  await page.waitForFunction(() => window.splatbus?.stage.standing && window.splatbus.figures?.gaussians > 1000 && window.splatbus.figures.missing === 0);
  let rest = await rested();
  for (const service of ['trainer', 'streamer', 'gateway', 'expander', 'relight', 'capture-bridge', 'bus']) {
    for (let time = 1, goesOn = false; !goesOn; ++time) {
      const before = rest;
      const during = await swapped(service);
      rest = await rested();
      const quiet = [...before.intervals, ...rest.intervals]; // on both sides, since what else the machine does comes and goes
      const [medianMs, usualMs] = [median(during.intervals), median(quiet)];
      const [longestMs, usualLongestMs] = [Math.max(...during.intervals), Math.max(...quiet)];
      const said = `${service}: median ${medianMs.toFixed(1)} ms, longest ${longestMs.toFixed(0)} ms, ${during.colors} colors; else ${usualMs.toFixed(1)} ms, ${usualLongestMs.toFixed(0)} ms, ${before.colors}`;
      t.diagnostic(said);
      assert.ok(during.colors > 0.5 * before.colors, said);
      goesOn = medianMs < kSlower * usualMs && longestMs < usualLongestMs + kLongerMs;
      assert.ok(goesOn || time < kTimes, said);
    }
  }
  assert.deepEqual(errors, []);
});
