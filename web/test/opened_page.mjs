// The page with a stream that a test makes (page/fake_stream_worker.ts), in a headless Chromium.
import assert from 'node:assert/strict';
import { after, before } from 'node:test';
import { launch, serve } from './browser.mjs';
import { colorsIn, readPng } from './png.mjs';

const kPages = process.env.SPLATBUS_WEB_TESTS ?? '../build/release/web-tests';
const kSite = process.env.SPLATBUS_WEB ?? '../build/release/share/splatbus/web';
let browser;
let server;
/** Bodies that pages have posted, as { path, body }. */
export const posted = [];
before(async () => {
  server = await serve([kPages, kSite], posted);
  browser = await launch();
});
after(async () => {
  await browser?.close();
  server?.close();
});

/** Takes the GPU's process from all pages, once: after another time Chromium does without one. */
export async function crashGpu() {
  const session = await browser.newBrowserCDPSession();
  await session.send('Browser.crashGpuProcess').catch(() => {}); // it ends before it answers
}

/** In the page: stills that are being made, and those of the picture at rest, which are of its own canvas, that were. */
function countStills() {
  const { toBlob } = HTMLCanvasElement.prototype;
  window.stills = { due: 0, atRest: 0 };
  HTMLCanvasElement.prototype.toBlob = function (hear, ...how) {
    const atRest = this.isConnected;
    ++window.stills.due;
    return toBlob.call(this, (blob) => {
      hear(blob);
      --window.stills.due;
      if (atRest) ++window.stills.atRest;
    }, ...how);
  };
}

/** The page, once it shows the scene at rest. `init` runs in it first, `before` here; `wrong`: the errors that are due. */
export async function opened(path, run, { init = () => {}, before: prepare = () => {}, wrong = [], ...options } = {}) {
  const context = await browser.newContext({ viewport: { width: 320, height: 200 }, ...options });
  const page = await context.newPage();
  page.setDefaultTimeout(90_000);
  await page.addInitScript(init);
  await page.addInitScript(countStills);
  await prepare(page);
  const errors = [];
  page.on('pageerror', (error) => errors.push(String(error)));
  try {
    await page.goto(`${server.url}/${path}`);
    await page.waitForFunction(() => window.splatbus?.stage.standing);
    await run(page);
    assert.deepEqual(errors, wrong);
  } finally {
    await context.close();
  }
}

/** For `before`: a page that is open already may have asked the server before the browser hands its requests over. */
export const answering = (address, answer) => (page) => page.route(address, answer);
/** Waits until the camera is to be as this says, to a millionth; input arrives with frames. */
export const reaches = (page, wanted) =>
  page.waitForFunction((pose) => Object.entries(pose).every(([key, value]) => Math.abs(window.splatbus.rig.goal[key] - value) < 1e-6), wanted);
export const goal = (page) => page.evaluate(() => window.splatbus.rig.goal);
export const kStart = { target: [0, 0, 0], yaw: 1, pitch: 0.5, distance: 4 };
export const view = (pose) => `view=${[...pose.target, pose.yaw, pose.pitch, pose.distance]}`;
export const kPage = `index.html#${view(kStart)}`;

/** A still is kept of the picture at rest. */
export const settled = (page) =>
  page.waitForFunction(() => {
    const still = document.querySelector('.still');
    return window.stills.atRest > 0 && window.stills.due === 0 && still.complete && still.naturalWidth > 300;
  });

/** Waits until a picture of that interface is shown. */
export const drawsBy = (page, api) =>
  page.waitForFunction((name) => {
    const { stage } = window.splatbus;
    return stage.renderer?.api === name && !stage.element.querySelector('canvas:not(.still)').hidden;
  }, api);
/** Waits until that is said of what is wrong. */
export const says = (page, text) => page.waitForFunction((part) => document.querySelector('.notice').textContent.includes(part), text);

/** Of the page's 320 x 200 pixels, those that no words cover. */
export const kMiddle = { x: 60, y: 60, width: 200, height: 100 };
/** Colors of the picture, as the screen would show them. */
export const shownColors = async (page) => colorsIn(readPng(await page.screenshot()), kMiddle);
