// The page in Firefox before a real pipeline: it shows what the engine draws of the same view, and goes on with the scene.
import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { launchFirefox } from './firefox.mjs';
import { startPipeline } from './pipeline.mjs';
import { colorsIn, readPng } from './png.mjs';

const kCapture = { input_cameras: 8, input_size: 64, sample_budget: 6000, reference_cameras: 4, reference_size: 64, reference_rate_hz: 1 };
const kSize = { width: 480, height: 300 };
/** What no words or buttons cover. */
const kMiddle = { x: 60, y: 60, width: 360, height: 150 };
let firefox;
let pipeline;
before(async () => {
  [pipeline, firefox] = await Promise.all([startPipeline(kCapture), launchFirefox(kSize)]);
});
after(async () => {
  await firefox?.close();
  await pipeline?.close();
});

const figures = () => firefox.evaluate('window.splatbus.figures');
const picture = async () => readPng(await firefox.screenshot());

/** Decibels between two parts of pictures that are as large; `flipped`: the second one upside down. */
function psnr(a, b, flipped = false) {
  let sum = 0;
  for (let y = 0; y < kMiddle.height; ++y) {
    for (let i = 0; i < 3 * kMiddle.width; ++i) {
      const at = (row) => 3 * (row * a.width + kMiddle.x) + i;
      sum += (a.rgb[at(kMiddle.y + y)] - b.rgb[at(kMiddle.y + (flipped ? kMiddle.height - 1 - y : y))]) ** 2;
    }
  }
  return 10 * Math.log10((255 * 255 * 3 * kMiddle.width * kMiddle.height) / Math.max(sum, 1));
}

test('a scene that is made while it is watched', async () => {
  await firefox.goto(`${pipeline.url}/#view=0,0.35,0,0.75,0.42,3.4`);
  await firefox.waitFor('window.splatbus?.stage.standing && window.splatbus.figures?.gaussians > 1000 && window.splatbus.figures.missing === 0');
  assert.equal(await firefox.evaluate('window.splatbus.stage.renderer.api'), 'webgl2');
  assert.ok(colorsIn(await picture(), kMiddle) > 500);
});

test('the picture is the engine\'s of the same view', async () => {
  await firefox.evaluate('(document.querySelector(".figures").hidden = true)');
  await firefox.press('c');
  await firefox.waitFor('window.splatbus.extras.comparison.quality');
  const { ssim, flip } = await firefox.evaluate('window.splatbus.extras.comparison.quality');
  assert.ok(ssim > 0.7 && flip < 0.3, `SSIM ${ssim}, FLIP ${flip}`);
  // As they are on the screen: all of it the engine's, then all of it of splats.
  await firefox.press('\uE011'); // Home
  const engine = await picture();
  await firefox.press('\uE010'); // End
  const splats = await picture();
  const [upright, upsideDown] = [psnr(engine, splats), psnr(engine, splats, true)];
  assert.ok(upright > 15 && upright > upsideDown + 5, `PSNR ${upright}, ${upsideDown} upside down`);
  await firefox.press('c');
});

test('it hears of what changes, and shows it', async () => {
  const before = await figures();
  const shown = await picture();
  await firefox.waitFor(`window.splatbus.figures.sequence > ${before.sequence} + 20 && window.splatbus.figures.sceneVersion > ${before.sceneVersion}`);
  assert.ok(psnr(shown, await picture()) < 60, 'another picture');
  await firefox.waitFor('window.splatbus.figures.roundTripMs > 0');
});

test('the gateway is killed: the picture stands, and the stream goes on', async () => {
  await pipeline.restarted('gateway');
  assert.ok(colorsIn(await picture(), kMiddle) > 500);
  const { bytes } = await figures();
  await firefox.waitFor(`window.splatbus.connection === "open" && window.splatbus.figures.bytes > ${bytes} && window.splatbus.figures.missing === 0`);
});
