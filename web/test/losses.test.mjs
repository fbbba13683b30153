// What the page does when what it draws by is lost: another takes its place, and until then the last picture stands, in
// every picture that the browser shows.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { filmed } from './browser.mjs';
import { crashGpu, kMiddle, kPage, opened, settled, shownColors } from './opened_page.mjs';
import { colorsIn, readPng } from './png.mjs';
import { letTrap, trapIn } from './trapping.mjs';

const kLimit = { timeout: 60_000 }; // sooner than ctest's, which would not say whose wait it was
const kColors = 500; // of the scene; a background alone has few
const kApis = ['webgl2', 'webgpu'];
const pageOf = (api) => kPage.replace('#', `?gpu=${api}#`);
/** All rows have been uploaded so many times, and are drawn. */
const uploaded = (page, times, count = 3000) =>
  page.waitForFunction((rows) => {
    const { stage } = window.splatbus;
    return stage.renderer && stage.uploadedRows === rows && !stage.element.querySelector('canvas:not(.still)').hidden;
  }, count * times);
const leastColors = (pictures) => Math.min(...pictures.map((picture) => colorsIn(readPng(picture), kMiddle)));

for (const api of kApis) {
  test(`${api}: a device that is lost comes back, and the last picture stands meanwhile`, kLimit, () =>
    opened(pageOf(api), async (page) => {
      await settled(page);
      const film = await filmed(page);
      // A context that is told to be lost, a device that is destroyed.
      await page.evaluate(() => window.splatbus.stage.renderer.dispose());
      await uploaded(page, 2);
      const pictures = await film();
      assert.ok(pictures.length > 0);
      assert.ok(leastColors(pictures) > kColors, `${leastColors(pictures)} colors in one`);
      assert.ok((await shownColors(page)) > kColors, 'it is drawn again');
    }));
}

test('the GPU\'s process ends: pages of both interfaces get devices of another, and their last pictures stand', kLimit, () =>
  opened(pageOf('webgl2'), (one) =>
    opened(pageOf('webgpu'), async (other) => {
      const pages = [one, other];
      await Promise.all(pages.map(settled));
      // Until the test says so no device is to be had; at once a browser has nothing to show pages with either.
      for (const page of pages) {
        await page.evaluate(() => {
          const { getContext } = HTMLCanvasElement.prototype;
          HTMLCanvasElement.prototype.getContext = () => null;
          window.giveDevices = () => (HTMLCanvasElement.prototype.getContext = getContext);
        });
      }
      await crashGpu();
      for (const page of pages) {
        await page.waitForFunction(() => !window.splatbus.stage.renderer);
        assert.ok((await shownColors(page)) > kColors, 'it stands');
        await page.evaluate(() => window.giveDevices());
      }
      await Promise.all(pages.map((page) => uploaded(page, 2)));
      for (const page of pages) assert.ok((await shownColors(page)) > kColors, 'it is drawn again');
    }),
  ));

for (const called of ['sort', 'sorter_update']) {
  test(`a trap in the sort worker's ${called}(): another worker sorts, and the picture stands`, kLimit, () =>
    opened(
      pageOf('webgl2'),
      async (page) => {
        await settled(page);
        const film = await filmed(page);
        const trapped = await trapIn(page, called);
        if (called === 'sort') await page.evaluate(() => window.splatbus.rig.orbit(0.1, 0));
        else await page.evaluate(() => new BroadcastChannel('change').postMessage(17));
        await trapped();
        await uploaded(page, 2);
        // It sorts, from where one looks now.
        const before = await page.evaluate(() => window.splatbus.frames);
        await page.evaluate(() => window.splatbus.rig.orbit(0.1, 0));
        await page.waitForFunction((then) => window.splatbus.frames > then, before);
        assert.ok(leastColors(await film()) > kColors);
      },
      { before: (page) => letTrap(page, 'sort_worker.js'), wrong: ['RuntimeError: memory access out of bounds'] },
    ));
}

test('a stream worker that dies is started again, and the picture stands', kLimit, () =>
  opened(kPage, async (page) => {
    await settled(page);
    const film = await filmed(page);
    await page.evaluate(() => window.splatbus.link.kill());
    await uploaded(page, 2);
    assert.ok(leastColors(await film()) > kColors);
  }));

test('a page that has room for a part of the model gets that part back, from another device and another worker', kLimit, () =>
  opened(
    pageOf('webgl2'),
    async (page) => {
      await uploaded(page, 1, 2000);
      await page.evaluate(() => window.splatbus.stage.renderer.dispose());
      await uploaded(page, 2, 2000);
      await page.evaluate(() => window.splatbus.link.kill());
      await uploaded(page, 3, 2000);
      assert.ok((await shownColors(page)) > kColors);
    },
    { init: () => localStorage.setItem('splatbus.settings', JSON.stringify({ budget: { gaussians: 2000 } })) },
  ));
