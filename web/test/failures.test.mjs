// What the page does when something that it draws or reckons by cannot do it, and nothing says that it is lost.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { filmed } from './browser.mjs';
import { answering, drawsBy, kMiddle, kPage, opened, says, settled, shownColors } from './opened_page.mjs';
import { colorsIn, readPng } from './png.mjs';

const kLimit = { timeout: 60_000 };
const kColors = 500; // of the scene; a background alone has few
const pageOf = (api) => kPage.replace('#', `?gpu=${api}#`);

test('a browser whose adapters do not say what they are draws by WebGPU', kLimit, () =>
  opened(kPage, async (page) => {
    await drawsBy(page, 'webgpu');
    assert.ok((await shownColors(page)) > kColors);
  }, { init: () => Object.defineProperty(GPUAdapter.prototype, 'info', { get: () => undefined }) }));

test('one whose WebGPU throws whatever it is asked draws by WebGL2', kLimit, () =>
  opened(kPage, async (page) => {
    await drawsBy(page, 'webgl2');
    assert.ok((await shownColors(page)) > kColors);
  }, {
    init: () =>
      Object.defineProperty(GPUAdapter.prototype, 'info', {
        get() {
          throw new TypeError('no info');
        },
      }),
  }));

test('a pipeline that cannot be made: WebGL2 draws', kLimit, () =>
  opened(pageOf('webgpu'), async (page) => {
    await drawsBy(page, 'webgl2');
    assert.ok((await shownColors(page)) > kColors);
    assert.equal(await page.evaluate(() => window.devices), 1, 'it is not tried again');
  }, {
    init: () => {
      window.devices = 0;
      const { requestDevice } = GPUAdapter.prototype;
      GPUAdapter.prototype.requestDevice = function (...given) {
        ++window.devices;
        return requestDevice.apply(this, given);
      };
      const { createShaderModule } = GPUDevice.prototype;
      GPUDevice.prototype.createShaderModule = function (asked) {
        return createShaderModule.call(this, asked.label === 'splats' ? { ...asked, code: 'no shader' } : asked);
      };
    },
  }));

test('an error of WebGPU while it draws: WebGL2 draws, and the last picture stands meanwhile', kLimit, () =>
  opened(pageOf('webgpu'), async (page) => {
    await settled(page);
    assert.equal(await page.evaluate(() => window.splatbus.stage.renderer.api), 'webgpu');
    const film = await filmed(page);
    await page.evaluate(() => {
      const { device } = window.splatbus.stage.renderer;
      device.createBuffer({ size: 2 ** 50, usage: GPUBufferUsage.STORAGE });
      device.queue.submit([]); // before that a browser need not look at it
    });
    await drawsBy(page, 'webgl2');
    await page.waitForFunction(() => window.splatbus.stage.uploadedRows === 6000);
    const colors = (await film()).map((picture) => colorsIn(readPng(picture), kMiddle));
    assert.ok(Math.min(...colors) > kColors, `${colors} colors`);
    assert.ok((await shownColors(page)) > kColors);
  }));

test('devices of WebGPU that are lost one after the other: WebGL2 draws', kLimit, () =>
  opened(pageOf('webgpu'), async (page) => {
    await drawsBy(page, 'webgl2');
    assert.ok((await page.evaluate(() => window.lost)) >= 3);
  }, {
    init: () => {
      window.lost = 0;
      const { requestDevice } = GPUAdapter.prototype;
      GPUAdapter.prototype.requestDevice = async function (...given) {
        const device = await requestDevice.apply(this, given);
        setTimeout(() => device.destroy(++window.lost), 50);
        return device;
      };
    },
  }));

test('a picture that cannot be saved ends no picture that is shown, and it is said', kLimit, () =>
  opened(pageOf('webgpu'), async (page) => {
    await settled(page);
    const { rows, api } = await page.evaluate(async () => {
      const { stage } = window.splatbus;
      const { device } = stage.renderer;
      const { createTexture } = device;
      device.createTexture = (asked) => createTexture.call(device, { ...asked, size: asked.format === 'rgba8unorm' ? [1 << 20, 1] : asked.size });
      await window.splatbus.extras.saveSnapshot();
      delete device.createTexture;
      await new Promise((resolve) => setTimeout(resolve, 500));
      return { rows: stage.uploadedRows, api: stage.renderer?.api };
    });
    assert.deepEqual({ rows, api }, { rows: 3000, api: 'webgpu' });
    await says(page, 'no picture to save');
    assert.ok((await shownColors(page)) > kColors);
  }));

for (const api of ['webgl2', 'webgpu']) {
  test(`${api}: saving a picture of a device that is gone is said to have failed`, kLimit, () =>
    opened(pageOf(api), async (page) => {
      await page.evaluate(async () => {
        window.splatbus.stage.renderer.dispose();
        await window.splatbus.extras.saveSnapshot();
      });
      await says(page, 'no picture to save');
    }));
}

test('webgl2: what a context shows that is lost before anybody has said so is no picture to keep', kLimit, () =>
  opened(pageOf('webgl2'), async (page) => {
    await settled(page);
    const drawn = await page.evaluate(async () => {
      const { stage, rig } = window.splatbus;
      const { renderer } = stage;
      const draw = renderer.draw.bind(renderer);
      const frame = await new Promise((resolve) => {
        renderer.draw = (given) => resolve(given, draw(given));
        rig.orbit(0.01, 0);
      });
      HTMLCanvasElement.prototype.getContext = () => null; // none comes in its place
      renderer.draw = draw;
      renderer.dispose();
      return stage.draw(frame, true);
    });
    assert.equal(drawn, false);
    await page.waitForFunction(() => !window.splatbus.stage.renderer);
    await page.evaluate(() => new Promise((resolve) => setTimeout(resolve, 300)));
    assert.ok((await shownColors(page)) > kColors, 'the last picture stands');
  }));

test('while things move the still is taken seldom and small', kLimit, () =>
  opened(
    pageOf('webgl2'),
    async (page) => {
      await page.waitForFunction(() => window.splatbus.firstPictureMs > 0);
      const taken = await page.evaluate(async () => {
        const { toBlob } = HTMLCanvasElement.prototype;
        const widths = [];
        HTMLCanvasElement.prototype.toBlob = function (...given) {
          widths.push(this.width);
          return toBlob.apply(this, given);
        };
        for (const begun = performance.now(); performance.now() - begun < 5000; ) {
          window.splatbus.rig.orbit(0.01, 0);
          await new Promise(requestAnimationFrame);
        }
        const moving = [...widths];
        while (!widths.includes(1000)) await new Promise((resolve) => setTimeout(resolve, 50));
        return { moving, all: widths };
      });
      assert.ok(taken.moving.length <= 1 && taken.moving.every((width) => width <= 640), `${taken.moving}`);
      assert.equal(taken.all.at(-1), 1000, 'at rest it is whole');
    },
    { viewport: { width: 1000, height: 600 } },
  ));

test('an address that asks for WebGPU shows the scene where there is none', kLimit, () =>
  opened(pageOf('webgpu'), async (page) => {
    await drawsBy(page, 'webgl2');
    assert.ok((await shownColors(page)) > 500);
  }, { init: () => delete Navigator.prototype.gpu }));

test('rows that were on their way to the renderer before are none of this one', kLimit, () =>
  opened(pageOf('webgpu'), async (page) => {
    const calls = await page.evaluate(async () => {
      const { stage } = window.splatbus;
      const calls = [];
      for (const name of ['clear', 'apply']) {
        const original = stage.renderer[name].bind(stage.renderer);
        stage.renderer[name] = (...given) => {
          calls.push(name === 'apply' ? given[0].rows.length : name);
          return original(...given);
        };
      }
      new BroadcastChannel('change').postMessage(17);
      for (const begun = performance.now(); performance.now() - begun < 300; ); // the worker has sent them, and the page has not come to it
      stage.feed();
      while (!calls.includes(3000)) await new Promise(requestAnimationFrame);
      return calls;
    });
    assert.deepEqual(calls, ['clear', 3000]);
  }));

test('a sorter that fails at everything it is told is replaced once', kLimit, () => {
  let scripts = 0;
  return opened(
    pageOf('webgl2'),
    async (page) => {
      await page.waitForFunction(() => window.splatbus.stage.uploadedRows > 0);
      await page.evaluate(() => new Promise((resolve) => setTimeout(resolve, 2000))); // longer than those would wait that are too many
      assert.equal(await page.evaluate(() => window.sorters), 2);
      assert.equal(await page.evaluate(() => window.splatbus.stage.uploadedRows), 3000);
    },
    {
      init: () => {
        window.sorters = 0;
        window.Worker = class extends Worker {
          constructor(...given) {
            super(...given);
            window.sorters += Number(given[1].name === 'sort');
          }
        };
      },
      before: (page) =>
        page.route('**/sort_worker.js', (route) =>
          ++scripts > 1 ? route.continue() : route.fulfill({ contentType: 'text/javascript', body: 'for (let k = 0; k < 5; ++k) setTimeout(() => { throw new Error("no"); }, k);' }),
        ),
      wrong: Array(5).fill('Error: no'),
    },
  );
});

test('a comparison whose worker dies says so, and the next has another', kLimit, () => {
  let scripts = 0;
  return opened(pageOf('webgl2'), async (page) => {
    await page.keyboard.press('c');
    await page.waitForFunction(() => document.querySelector('.compare .quality').textContent.includes('could not be measured'));
    assert.equal(await page.locator('.compare .right').isVisible(), true, 'the engine\'s picture is there');
    await page.waitForFunction(() => window.splatbus.extras.comparison.quality);
  }, {
    before: async (page) => {
      await answering('**/status', (route) => route.fulfill({ json: { rights: 'view,probe' } }))(page);
      await page.route('**/metrics_worker.js', (route) =>
        ++scripts > 1 ? route.continue() : route.fulfill({ status: 404 }),
      );
    },
  });
});

test('a comparison that takes longer than the next picture is shown', kLimit, () =>
  opened(pageOf('webgl2'), async (page) => {
    await page.keyboard.press('c');
    await page.waitForFunction(() => window.splatbus.extras.comparison.quality?.ssim === 0.5, null, { timeout: 20_000 });
  }, {
    before: async (page) => {
      await answering('**/status', (route) => route.fulfill({ json: { rights: 'view,probe' } }))(page);
      const slow = 'let done = 0; onmessage = ({ data: { id } }) => { done = Math.max(done, performance.now()) + 4000; setTimeout(() => postMessage({ id, ssim: 0.5, flip: 0.5 }), done - performance.now()); };';
      await page.route('**/metrics_worker.js', (route) => route.fulfill({ contentType: 'text/javascript', body: slow }));
    },
  }),
);

/** The stream's worker ends for want of memory, and is not started again of its own accord. */
const failsForGood = (page) =>
  page.evaluate(async () => {
    const later = window.setTimeout;
    window.setTimeout = (act, ms, ...given) => later(act, ms > 3000 ? 2 ** 30 : ms, ...given);
    new BroadcastChannel('fail').postMessage('RangeError: Array buffer allocation failed');
    while (window.splatbus.connection !== 'waiting') await new Promise(requestAnimationFrame);
    window.setTimeout = later;
  });

test('a device that has too little memory for the scene: the page says so and what helps, and does it', kLimit, () =>
  opened(kPage, async (page) => {
    await settled(page);
    await failsForGood(page);
    await says(page, 'too little memory');
    await says(page, 'fewer Gaussians in the menu');
    assert.ok((await shownColors(page)) > kColors, 'the picture stands');
    await page.keyboard.press('m');
    await page.getByLabel('Gaussians at most').selectOption('100000');
    await page.waitForFunction(() => window.splatbus.stage.uploadedRows === 6000); // who asks for less does not wait
    await page.waitForFunction(() => document.querySelector('.notice').textContent === '');
    // Anything else that a worker dies of is over as soon as there is another.
    await page.evaluate(() => new BroadcastChannel('fail').postMessage('RuntimeError: unreachable'));
    await says(page, 'had to be started again');
    await page.waitForFunction(() => window.splatbus.stage.uploadedRows === 9000);
  }));

test('too little memory is no more said of a world beyond the budget once all is there that comes, nor where fewer were asked for since', { timeout: 90_000 }, () =>
  opened(kPage, async (page) => {
    await settled(page);
    await page.evaluate(() => new BroadcastChannel('fail').postMessage('RangeError: Array buffer allocation failed'));
    await says(page, 'too little memory');
    await page.waitForFunction(() => document.querySelector('.notice').textContent === '', undefined, { timeout: 40_000 });
    assert.equal(await page.evaluate(() => window.splatbus.figures.missing), 7);
    await failsForGood(page);
    await says(page, 'too little memory');
    await page.keyboard.press('m');
    const budget = page.getByLabel('Gaussians at most');
    await budget.selectOption('100000');
    await budget.selectOption('1000000');
    await page.waitForFunction(() => window.splatbus.connection === 'open' && document.querySelector('.notice').textContent === '');
  }, { init: () => localStorage.getItem('splatbus.settings') ?? localStorage.setItem('splatbus.settings', JSON.stringify({ budget: { gaussians: 2000 } })) }));

test('a sort that nobody does takes no time', kLimit, () =>
  opened(pageOf('webgpu'), async (page) => {
    await page.evaluate(() => window.splatbus.stage.lend());
    await page.waitForFunction(() => window.splatbus.stage.sortMs !== null);
    await page.evaluate(() => window.splatbus.stage.takeBack());
    await drawsBy(page, 'webgpu');
    await page.waitForFunction(() => document.querySelector('[data-figure=sort]').textContent === '-');
  }));
