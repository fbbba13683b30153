// Both renderers against the definition of the picture in double precision.
import assert from 'node:assert/strict';
import { writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { after, before, describe, test } from 'node:test';
import { launch, serve } from './browser.mjs';

const kPages = process.env.SPLATBUS_WEB_TESTS ?? '../build/release/web-tests';
/** 57.3 dB and 0.9996 are measured; rounding to 8 bits alone gives 58.9. What is asked for, 45 dB, a wrong constant reaches. */
const kLeastPsnr = 55;
const kLeastSsim = 0.9992;
/** A folder for the pictures, for who wants to look at them. */
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

for (const api of ['webgl2', 'webgpu']) {
  describe(api, () => {
    let page;
    const errors = [];
    before(async () => {
      page = await browser.newPage();
      page.on('pageerror', (error) => errors.push(String(error)));
      page.on('console', (message) => message.type() === 'error' && errors.push(message.text()));
      await page.goto(`${server.url}/picture.html`);
    });
    after(() => page.close());

    for (const mip of [true, false]) {
      test(`pictures are those of the definition, ${mip ? 'with' : 'without'} the filter of training`, async () => {
        const results = await page.evaluate(([name, filtered]) => window.tests.pictures(name, 4000, 192, filtered), [api, mip]);
        results.forEach((result, index) => {
          if (kPictures) writeFileSync(join(kPictures, `${api}_${index}${mip ? '' : '_unfiltered'}.png`), Buffer.from(result.png, 'base64'));
          console.log(`${api} ${index}: PSNR ${result.psnr.toFixed(2)} dB, SSIM ${result.ssim.toFixed(5)}`);
          assert.ok(result.psnr >= kLeastPsnr, `PSNR ${result.psnr}`);
          assert.ok(result.ssim >= kLeastSsim, `SSIM ${result.ssim}`);
        });
      });
    }

    test('only changed rows are uploaded', async () => {
      const { rows, psnr } = await page.evaluate((name) => window.tests.changes(name), api);
      assert.deepEqual(rows, [3000, 3000 + 1000 + 17000]);
      assert.ok(psnr >= kLeastPsnr, `PSNR ${psnr}`);
    });

    test('colors alone are replaced, linear or in display space', async () => {
      const { bytes, psnr, display } = await page.evaluate((name) => window.tests.colors(name), api);
      assert.equal(bytes, 3000 * 8);
      assert.ok(psnr >= kLeastPsnr, `PSNR ${psnr}`);
      assert.ok(display >= 45, `PSNR ${display} in display space`);
    });

    test('between two scenes colors are between those that were shaded for them', async () => {
      for (const { shownMs, psnr, bytes, due } of await page.evaluate((name) => window.tests.played(name), api)) {
        assert.ok(psnr >= kLeastPsnr, `PSNR ${psnr} at ${shownMs} ms`);
        assert.equal(bytes, due, `bytes until ${shownMs} ms`);
      }
    });

    test('of those at one depth later rows are in front', async () => {
      const psnr = await page.evaluate((name) => window.tests.equalDepths(name), api);
      assert.ok(psnr >= kLeastPsnr, `PSNR ${psnr}`);
    });

    test('nothing is left when the camera turns away', async () => {
      assert.equal(await page.evaluate((name) => window.tests.away(name), api), 0);
    });

    test('the far field goes with the eye', async () => {
      const psnr = await page.evaluate((name) => window.tests.farField(name), api);
      assert.ok(psnr >= kLeastPsnr, `PSNR ${psnr}`);
    });

    test('rows that come and go fade', async () => {
      for (const { since, atS, psnr } of await page.evaluate((name) => window.tests.fading(name), api)) {
        assert.ok(psnr >= kLeastPsnr, `PSNR ${psnr} of rows since ${since} at ${atS} s`);
      }
    });

    test('nothing was said to be wrong', () => assert.deepEqual(errors, []));
  });
}

test('webgpu: harmonics that come late find room, or it is said that there is none', async () => {
  const page = await browser.newPage();
  try {
    await page.goto(`${server.url}/picture.html`);
    const { psnr, errors, buffers, lost } = await page.evaluate(() => window.tests.lateHarmonics());
    assert.deepEqual(errors, []);
    assert.ok(psnr >= kLeastPsnr, `PSNR ${psnr}`);
    assert.equal(buffers, 0, 'there is room already');
    assert.match(lost, /holds \d+ rows, and there are 1402000/);
  } finally {
    await page.close();
  }
});
