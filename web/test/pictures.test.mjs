// Both renderers against the definition of the picture in double precision.
import assert from 'node:assert/strict';
import { writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { after, before, test } from 'node:test';
import { launch, serve } from './browser.mjs';

const kPages = process.env.SPLATBUS_WEB_TESTS ?? '../build/release/web-tests';
const kPictures = process.env.SPLATBUS_WEB_PICTURES;
let browser;
let server;
before(async () => {
  server = await serve([kPages]);
  browser = await launch();
});
after(async () => {
  await browser?.close();
  server?.close();
});

async function withPage(run) {
  const page = await browser.newPage();
  page.on('pageerror', (error) => console.error(error));
  page.on('console', (message) => message.type() === 'error' && console.error(message.text()));
  try {
    await page.goto(`${server.url}/picture.html`);
    return await run(page);
  } finally {
    await page.close();
  }
}

for (const api of ['webgl2', 'webgpu']) {
  test(`${api}: pictures are those of the definition`, async () => {
    const results = await withPage((page) => page.evaluate((name) => window.tests.pictures(name, 4000, 192), api));
    results.forEach((result, index) => {
      if (kPictures) writeFileSync(join(kPictures, `${api}_${index}.png`), Buffer.from(result.png, 'base64'));
      console.log(`${api} ${index}: PSNR ${result.psnr.toFixed(2)} dB, SSIM ${result.ssim.toFixed(5)}`);
      assert.ok(result.psnr >= 45, `PSNR ${result.psnr}`);
      assert.ok(result.ssim >= 0.998, `SSIM ${result.ssim}`);
    });
  });

  test(`${api}: only changed rows are uploaded`, async () => {
    const { rows, psnr } = await withPage((page) => page.evaluate((name) => window.tests.changes(name), api));
    assert.deepEqual(rows, [3000, 3000 + 1000 + 47000]);
    assert.ok(psnr >= 45, `PSNR ${psnr}`);
  });

  test(`${api}: colors alone are replaced, linear or in display space`, async () => {
    const { bytes, psnr, display } = await withPage((page) => page.evaluate((name) => window.tests.colors(name), api));
    assert.equal(bytes, 3000 * 8);
    assert.ok(psnr >= 45, `PSNR ${psnr}`);
    assert.ok(display >= 45, `PSNR ${display} in display space`);
  });

  test(`${api}: the far field goes with the eye`, async () => {
    const psnr = await withPage((page) => page.evaluate((name) => window.tests.farField(name), api));
    assert.ok(psnr >= 45, `PSNR ${psnr}`);
  });
}
