// The page in Firefox, through WebGL2 in software: the picture is that of the definition, and the page shows its stream and
// is steered.
import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { serve } from './browser.mjs';
import { launchFirefox } from './firefox.mjs';
import { colorsIn, readPng } from './png.mjs';

const { SPLATBUS_WEB: site, SPLATBUS_WEB_TESTS: pages } = process.env;
let firefox;
let server;
before(async () => {
  server = await serve([pages, site]);
  firefox = await launchFirefox({ width: 480, height: 300 });
});
after(async () => {
  await firefox?.close();
  server?.close();
});

test('pictures are those of the definition', async () => {
  await firefox.goto(`${server.url}/picture.html`);
  const results = await firefox.evaluate("window.tests.pictures('webgl2', 2000, 128, true)");
  for (const { psnr, ssim } of results) assert.ok(psnr >= 55 && ssim >= 0.9992, `PSNR ${psnr}, SSIM ${ssim}`);
});

test('the page shows a stream, flies by keys, and sorts in its worker', async () => {
  await firefox.goto(`${server.url}/index.html#view=0,0,0,1,0.5,4`);
  await firefox.waitFor('window.splatbus?.stage.standing');
  assert.equal(await firefox.evaluate('window.splatbus.stage.renderer.api'), 'webgl2');
  assert.equal(await firefox.evaluate('window.splatbus.stage.uploadedRows'), 3000);
  await firefox.waitFor('window.splatbus.stage.sortMs !== null');
  await firefox.press('f');
  await firefox.waitFor('window.splatbus.rig.goal.distance !== 4');
  await firefox.waitFor('window.splatbus.rig.shown === window.splatbus.rig.goal');
});

test('a context that is lost comes back, and the last picture stands meanwhile', async () => {
  const colors = async () => colorsIn(readPng(await firefox.screenshot()), { x: 60, y: 60, width: 360, height: 150 });
  await firefox.waitFor('document.querySelector(".still").naturalWidth > 0 && document.querySelector("[data-figure=frames]").textContent === "at rest"');
  const before = await colors();
  assert.ok(before > 500, `${before} colors`);
  await firefox.evaluate('(window.hold = HTMLCanvasElement.prototype.getContext, HTMLCanvasElement.prototype.getContext = () => null, window.splatbus.stage.renderer.dispose())');
  await firefox.waitFor('!window.splatbus.stage.renderer');
  const standing = await colors();
  assert.ok(standing > before / 2, `${standing} colors of ${before}`);
  await firefox.evaluate('(HTMLCanvasElement.prototype.getContext = window.hold, true)');
  await firefox.waitFor('window.splatbus.stage.renderer && window.splatbus.stage.uploadedRows === 6000');
});
