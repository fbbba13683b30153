// node test/screenshots.mjs FOLDER: the README's pictures of the page before the demo's scene, in Chromium and, where it is
// there, in Firefox. Takes the environment that ctest gives to the browser tests.
import { writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { launch } from './browser.mjs';
import { hasFirefox, launchFirefox } from './firefox.mjs';
import { startPipeline, until } from './pipeline.mjs';

const [folder = '.', steps = '1500'] = process.argv.slice(2);
const kCapture = { input_cameras: 24, input_size: 128, sample_budget: 60000, reference_cameras: 8, reference_size: 160, reference_rate_hz: 2 };
const kSize = { width: 960, height: 600 };
const kView = '#view=0,0.35,0,0.75,0.42,3.4';
/** All of it has come, and has been drawn once it has faded in. */
const kWhole = `(() => {
  const { stage, figures, frames } = window.splatbus ?? {};
  if (!figures || figures.missing > 0 || figures.gaussians < 30000 || stage.uploadedRows < figures.gaussians) return false;
  return frames > (window.wholeAt ??= frames) + 20;
})()`;
/** As fine as the window: software draws no more than a few frames a second. */
const kSettings = JSON.stringify({ quality: 'full' });

const pipeline = await startPipeline(kCapture);
const trained = () =>
  until(async () => (await pipeline.status()).services.some(({ service, counters }) => service === 'trainer' && counters.step >= Number(steps)));
try {
  const browser = await launch();
  const page = await browser.newPage({ viewport: kSize });
  page.setDefaultTimeout(600_000);
  await page.addInitScript((settings) => localStorage.setItem('splatbus.settings', settings), kSettings);
  await page.goto(`${pipeline.url}/${kView}`);
  await trained();
  await page.waitForFunction(kWhole);
  writeFileSync(join(folder, 'page_chromium.png'), await page.screenshot());
  await page.keyboard.press('i');
  await page.keyboard.press('c');
  await page.waitForFunction(() => window.splatbus.extras.comparison.quality);
  writeFileSync(join(folder, 'page_compare.png'), await page.screenshot());
  await browser.close();
  if (hasFirefox) {
    const firefox = await launchFirefox(kSize);
    await firefox.goto(`${pipeline.url}/healthz`);
    await firefox.evaluate(`localStorage.setItem('splatbus.settings', ${JSON.stringify(kSettings)})`);
    await firefox.goto(`${pipeline.url}/${kView}`);
    await firefox.waitFor(kWhole);
    writeFileSync(join(folder, 'page_firefox.png'), await firefox.screenshot());
    await firefox.close();
  }
} finally {
  await pipeline.close();
}
