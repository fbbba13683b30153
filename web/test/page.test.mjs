// The page with a stream that a test makes: address, uploads, menu, comparison, files.
import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';
import { test } from 'node:test';
import { answering, goal, kPage, kStart, opened, posted, shownColors, view } from './opened_page.mjs';

test('the address has the view and not the token, and shows the same again', () =>
  opened(`index.html?token=abc&gpu=webgl2#${view(kStart)}`, async (page) => {
    assert.ok(!page.url().includes('abc'), page.url());
    assert.ok(page.url().includes('gpu=webgl2'));
    assert.equal(await page.evaluate(() => window.splatbus.link.options.token), 'abc');
    assert.deepEqual(await goal(page), kStart);
    await page.mouse.move(160, 100);
    await page.mouse.wheel(0, -300);
    await page.waitForFunction(() => location.hash.includes('2.916'));
    const left = await goal(page);
    const address = page.url();
    await page.goto('about:blank');
    await page.goto(address);
    await page.waitForFunction(() => window.splatbus?.stage.standing);
    const again = await goal(page);
    for (const key of ['yaw', 'pitch', 'distance']) assert.ok(Math.abs(again[key] - left[key]) < 1e-3, key);
    assert.equal(await page.evaluate(() => window.splatbus.link.options.token), 'abc');
  }));

test('a token that comes into an open tab is taken, and out of the address', () =>
  opened(kPage, async (page) => {
    await page.evaluate(() => {
      window.sameDocument = true;
      location.hash = 'token=xyz';
    });
    await page.waitForFunction(() => window.splatbus.link.options.token === 'xyz');
    assert.ok(!page.url().includes('xyz'), page.url());
    assert.ok(await page.evaluate(() => window.sameDocument));
    assert.deepEqual(await goal(page), kStart, 'it says no view');
    // A worker that has started anew brings all of the scene again.
    await page.waitForFunction(() => window.splatbus.stage.uploadedRows === 6000);
    await page.reload();
    await page.waitForFunction(() => window.splatbus?.stage.standing);
    assert.equal(await page.evaluate(() => window.splatbus.link.options.token), 'xyz');
  }));

test('after the first picture only rows that change are uploaded', () =>
  opened(kPage, async (page) => {
    const uploaded = () => page.evaluate(() => window.splatbus.stage.uploadedRows);
    assert.equal(await uploaded(), 3000);
    await page.evaluate(() => window.splatbus.rig.zoom(0.9));
    await page.waitForFunction(() => window.splatbus.rig.shown.distance === window.splatbus.rig.goal.distance);
    assert.equal(await uploaded(), 3000, 'a camera that moves uploads no row');
    await page.evaluate(() => new BroadcastChannel('change').postMessage(17));
    await page.waitForFunction(() => window.splatbus.stage.uploadedRows !== 3000);
    assert.equal(await uploaded(), 3017);
  }));

/** Bytes that WebGL is handed, by its own functions. */
function countHandedOver() {
  const { bufferData, texSubImage2D } = WebGL2RenderingContext.prototype;
  window.handedOver = 0;
  Object.assign(WebGL2RenderingContext.prototype, {
    bufferData(...given) {
      window.handedOver += given[1].byteLength;
      return bufferData.apply(this, given);
    },
    texSubImage2D(...given) {
      const [, , , , width, height, format] = given;
      window.handedOver += 4 * width * height * (format === this.RED_INTEGER ? 1 : 4);
      return texSubImage2D.apply(this, given);
    },
  });
}

test('WebGL2 is handed what changed and no more: rows, their order, and where objects are', () =>
  opened(
    kPage.replace('#', '?gpu=webgl2#'),
    async (page) => {
      const kObjects = 3 * 48; // once a picture
      const soFar = () =>
        page.evaluate(() => {
          const { renderer } = window.splatbus.stage;
          return { handedOver: window.handedOver, frames: window.splatbus.frames, ...renderer.uploaded };
        });
      const since = async (then) => Object.fromEntries(Object.entries(await soFar()).map(([key, value]) => [key, value - then[key]]));
      /** Half a second and some turns of the display without a picture. */
      const rests = async () => {
        await page.evaluate(async () => {
          const turn = () => new Promise(requestAnimationFrame);
          for (let frames = -1, turns = 0, since = 0; turns < 10 || performance.now() - since < 500; ++turns) {
            await turn();
            if (window.splatbus.frames > 0 && window.splatbus.frames === frames) continue;
            ({ frames } = window.splatbus);
            [turns, since] = [0, performance.now()];
          }
        });
        return soFar();
      };
      const first = await rests();
      assert.equal(first.bytes, 3000 * (4 + 32 + 4));
      assert.equal(first.handedOver, first.bytes + first.orderBytes + kObjects * first.frames);
      await page.evaluate(() => new Promise((resolve) => setTimeout(resolve, 300)));
      assert.deepEqual(await soFar(), first, 'at rest nothing is');
      // The camera moves: of rows their order alone, of those before it, once for each sort.
      await page.evaluate(() => window.splatbus.rig.orbit(0.2, 0));
      await page.waitForFunction(() => window.splatbus.rig.shown === window.splatbus.rig.goal);
      await rests();
      const moved = await since(first);
      assert.equal(moved.bytes, 0);
      assert.equal(moved.handedOver, moved.orderBytes + kObjects * moved.frames);
      assert.ok(moved.orderBytes > 0 && moved.orderBytes <= 4 * 3000 * moved.frames, JSON.stringify(moved));
      const then = await rests();
      await page.evaluate(() => new BroadcastChannel('change').postMessage(17));
      await page.waitForFunction((rows) => window.splatbus.stage.uploadedRows === rows + 17, then.rows);
      await rests();
      const changed = await since(then);
      assert.equal(changed.bytes, 17 * (4 + 32 + 4));
      assert.equal(changed.handedOver, changed.bytes + changed.orderBytes + kObjects * changed.frames);
      assert.ok(changed.orderBytes <= 4 * 3000, 'one order for one change');
    },
    { init: countHandedOver },
  ));

/** Orders come a few frames after what has none. */
function slowOrders() {
  window.Worker = class extends Worker {
    set onmessage(hear) {
      super.onmessage = (event) => (event.data?.order ? setTimeout(() => hear(event), 100) : hear(event));
    }
  };
}

test('rows and the order that knows them are shown in one frame', () =>
  opened(kPage.replace('index.html', 'index.html?gpu=webgl2'), async (page) => {
    const early = await page.evaluate(async () => {
      const { stage } = window.splatbus;
      const { renderer } = stage;
      let unordered = 0; // rows in memory that no order knows yet
      let seen = 0;
      let early = 0;
      const before = (name, act) => {
        const original = renderer[name].bind(renderer);
        renderer[name] = (...given) => {
          act(...given);
          return original(...given);
        };
      };
      before('apply', ({ rows }) => {
        unordered += rows.length;
        seen += rows.length;
      });
      before('setOrder', () => (unordered = 0));
      before('draw', () => (early += unordered));
      const channel = new BroadcastChannel('change');
      for (let k = 1; k <= 5; ++k) {
        channel.postMessage(100 * k);
        while (seen < 50 * k * (k + 1)) {
          window.splatbus.rig.orbit(0.001, 0); // what is drawn meanwhile
          await new Promise(requestAnimationFrame);
        }
      }
      await new Promise(requestAnimationFrame);
      return early;
    });
    assert.equal(early, 0);
  }, { init: slowOrders }));

test('menu by keys alone: quality, background, budget; they are kept', () =>
  opened(kPage, async (page) => {
    await page.keyboard.press('m');
    await page.getByRole('dialog', { name: 'Menu' }).waitFor();
    const white = async () => (await page.screenshot({ clip: { x: 300, y: 190, width: 2, height: 2 } })).toString('base64');
    const before = await white();
    await page.getByLabel('Background').focus();
    await page.keyboard.press('w'); // as select elements do: the option that begins so
    await page.waitForFunction(() => localStorage.getItem('splatbus.settings')?.includes('"background":"white"'));
    await page.getByLabel('Quality').selectOption('low');
    await page.getByLabel('Gaussians at most').selectOption('300000');
    await page.keyboard.press('Escape');
    await page.getByRole('dialog').waitFor({ state: 'hidden' });
    await page.waitForFunction(() => document.querySelector('[data-figure=resolution]').textContent === '35 %');
    // Another budget is another stream, of which the picture is drawn anew.
    await page.waitForFunction(() => window.splatbus.link.options.budget.gaussians === 300000 && window.splatbus.stage.uploadedRows === 6000);
    assert.notEqual(await white(), before);
    await page.reload();
    await page.waitForFunction(() => window.splatbus?.stage.standing);
    assert.equal(await page.evaluate(() => window.splatbus.options.settings.quality), 'low');
  }));

test('figures that somebody hides or shows are so the next time', () =>
  opened(kPage, async (page) => {
    const hidden = () => page.evaluate(() => document.querySelector('.figures').hidden);
    const again = async () => {
      await page.reload();
      await page.waitForFunction(() => window.splatbus?.stage.standing);
      return hidden();
    };
    assert.equal(await hidden(), true, 'a small screen has none to begin with');
    await page.keyboard.press('i');
    assert.equal(await again(), false);
    const menu = page.getByRole('button', { name: 'Menu', expanded: false });
    await menu.click();
    await page.getByRole('button', { name: 'Menu', expanded: true }).waitFor();
    await page.getByRole('button', { name: 'Figures', pressed: true }).click();
    await page.getByRole('button', { name: 'Figures', pressed: false }).waitFor();
    assert.equal(await again(), true);
  }));

test('how fast one flies is chosen in the menu and kept', () =>
  opened(kPage, async (page) => {
    /** Metres that a second of W is. */
    const metres = () =>
      page.evaluate(() => {
        const { rig } = window.splatbus;
        const before = rig.goal.target;
        rig.fly({ right: 0, up: 0, ahead: 1, fast: false }, 1);
        return Math.hypot(...rig.goal.target.map((value, k) => value - before[k]));
      });
    const usual = await metres();
    assert.ok(Math.abs(usual - 0.8 * kStart.distance) < 1e-6, `${usual}`);
    await page.keyboard.press('m');
    await page.getByLabel('Speed').selectOption('fast');
    assert.ok(Math.abs((await metres()) - 3 * usual) < 1e-6);
    await page.reload();
    await page.waitForFunction(() => window.splatbus?.stage.standing);
    assert.ok(Math.abs((await metres()) - 3 * usual) < 1e-3);
  }));

test('nothing to be read or touched is under a notch', () =>
  opened(kPage, async (page) => {
    const session = await page.context().newCDPSession(page);
    await page.keyboard.press('m');
    await page.keyboard.press('i');
    const edges = () =>
      page.evaluate(() =>
        Object.fromEntries(
          ['.bar button', '.menu', '.figures', '.stick'].map((name) => {
            const element = document.querySelector(name);
            element.hidden = false;
            const { left, top, right, bottom } = element.getBoundingClientRect();
            return [name, { left, top, right: innerWidth - right, bottom: innerHeight - bottom }];
          }),
        ),
      );
    const before = await edges();
    await session.send('Emulation.setSafeAreaInsetsOverride', { insets: { top: 10, left: 20, bottom: 30, right: 40 } });
    await page.waitForFunction((right) => innerWidth - document.querySelector('.bar button').getBoundingClientRect().right > right, before['.bar button'].right);
    const after = await edges();
    const further = (name, side) => after[name][side] - before[name][side];
    assert.deepEqual([further('.bar button', 'right'), further('.bar button', 'top')], [40, 10]);
    assert.deepEqual([further('.menu', 'right'), further('.menu', 'top')], [40, 10]);
    assert.deepEqual([further('.figures', 'left'), further('.figures', 'top')], [20, 10]);
    assert.deepEqual([further('.stick', 'left'), further('.stick', 'bottom')], [20, 30]);
    assert.ok(after['.menu'].left >= 20 && after['.menu'].bottom >= 30 - 1e-6, JSON.stringify(after['.menu']));
  }));

test('a rate is asked for in the menu, at once and for the next time', () =>
  opened(kPage, async (page) => {
    await page.evaluate(() => (new BroadcastChannel('asked').onmessage = ({ data }) => (window.asked ??= []).push(data)));
    const says = (pattern) =>
      page.waitForFunction((source) => new RegExp(source).test(document.querySelector('[data-figure=rate]').textContent), pattern.source);
    await says(/^\d+\.\d\d$/);
    await page.keyboard.press('m');
    await page.getByLabel('Mbit/s at most').selectOption('5');
    await page.waitForFunction(() => window.asked?.length === 1 && window.asked[0] === 5);
    await says(/ of 5$/);
    assert.equal(await page.evaluate(() => window.splatbus.stage.uploadedRows), 3000, 'the stream goes on');
    await page.reload();
    await page.waitForFunction(() => window.splatbus?.stage.standing);
    assert.equal(await page.evaluate(() => window.splatbus.link.options.budget.megabits), 5);
  }));

test('who is not let in is told so, and not that nobody is there', () => {
  let status = (route) => route.abort();
  return opened(`index.html?token=abc#${view(kStart)}`, async (page) => {
    const says = (text) => page.waitForFunction((part) => document.querySelector('.notice').textContent.includes(part), text);
    const lost = (retryS) => page.evaluate((seconds) => new BroadcastChannel('connection').postMessage(seconds), retryS);
    await lost(30);
    await says('No connection. Trying again in');
    const spoken = () => page.evaluate(() => document.querySelector('[role=status].spoken').textContent);
    const said = await spoken();
    await page.waitForFunction((first) => document.querySelector('.notice').textContent !== first, said);
    assert.equal(await spoken(), said, 'a second that has passed is no news');
    await page.waitForFunction(() => document.querySelector('[data-figure=connection]').textContent === 'Lost');
    await page.keyboard.press('c');
    await says('does not answer');
    status = (route) => route.fulfill({ status: 401, body: 'a token is needed' });
    await lost(30);
    await says('does not accept the token');
    assert.ok((await shownColors(page)) > 500, 'the picture stands');
    await lost(0);
    await page.waitForFunction(() => document.querySelector('.notice').textContent === '');
  }, { before: answering('**/status', (route) => status(route)) });
});

test('a snapshot is a PNG of the picture', () =>
  opened(kPage, async (page) => {
    const download = page.waitForEvent('download');
    await page.keyboard.press('p');
    const saved = await download;
    assert.match(saved.suggestedFilename(), /^splatbus-.*\.png$/);
    const bytes = readFileSync(await saved.path());
    assert.deepEqual([...bytes.subarray(1, 4)], [...Buffer.from('PNG')]);
    assert.equal(bytes.readUInt32BE(16), 320);
  }));

for (const api of ['webgl2', 'webgpu']) {
  test(`${api}: a flight is measured as the display goes, and by what a picture costs, shown and posted`, { timeout: 120_000 }, async () => {
    const flown = async (width, height) => {
      let report;
      await opened(kPage.replace('#', `?gpu=${api}&bench=1&seconds=3#`), async (page) => {
        await page.waitForFunction(() => document.body.dataset.bench);
        const shown = JSON.parse(await page.evaluate(() => document.body.dataset.bench));
        const { path, body } = posted.at(-1);
        assert.equal(path, '/bench');
        report = JSON.parse(body);
        assert.deepEqual(report, shown);
        assert.equal(report.api, api);
        assert.deepEqual([report.width, report.height, report.gaussians], [width, height, 3000], body);
        for (const figures of [report, report.drawing]) {
          assert.ok(figures.frames > 3 && figures.medianMs > 0 && figures.p99Ms >= figures.medianMs, body);
          assert.ok(Math.abs(figures.framesPerSecond - figures.frames / figures.seconds) < 1e-6, body);
        }
        assert.ok(body.length < 1024, 'all of it is logged');
        await page.waitForFunction((ms) => document.querySelector('.notice').textContent.includes(`Drawing one takes ${ms} ms`), report.drawing.medianMs.toFixed(2));
      }, { viewport: { width, height } });
      return report.drawing;
    };
    const [few, many] = [await flown(320, 200), await flown(640, 400)];
    // By software the pixels are most of it; by how much is not asked, for others may want the same cores.
    assert.ok(many.medianMs > few.medianMs, `${few.medianMs} ms of few pixels, ${many.medianMs} ms of four times as many`);
  });
}

test('a slider between the engine\'s own picture and the splats, and how alike they are', () => {
  let rights = 'view';
  let held = null;
  return opened(`${kPage.replace('index.html', 'index.html?gpu=webgl2')}`, async (page) => {
    await page.keyboard.press('c');
    await page.waitForFunction(() => document.querySelector('.notice').textContent.includes('may not'));
    rights = 'view,probe';
    await page.evaluate(() => {
      const label = document.querySelector('.compare .right');
      const stop = new MutationObserver(() => (window.namedEarly ??= getComputedStyle(label).display !== 'none' && document.querySelector('.compare canvas').hidden));
      stop.observe(document.querySelector('.compare'), { attributes: true });
    });
    // Who is impatient wants it no less.
    held = [];
    await page.keyboard.press('c');
    await page.keyboard.press('c');
    await page.waitForTimeout(300); // as long as the server takes
    for (const answer of held) await answer();
    held = null;
    await page.waitForFunction(() => window.splatbus.extras.comparison.quality);
    assert.equal(await page.evaluate(() => window.namedEarly), false, 'splats are not called the engine\'s');
    assert.equal(await page.locator('.compare .right').isVisible(), true);
    const { ssim, flip } = await page.evaluate(() => window.splatbus.extras.comparison.quality);
    assert.ok(ssim > 0.995 && flip < 0.02, `SSIM ${ssim}, FLIP ${flip}`);
    assert.match(await page.locator('.compare .quality').textContent(), /SSIM 0\.99\d +FLIP 0\.0[01]\d|SSIM 1\.000/);
    // By the keyboard: all of it the engine's.
    const clipped = () => page.evaluate(() => getComputedStyle(document.querySelector('.compare .engine')).clipPath);
    const half = await clipped();
    await page.locator('.compare input').focus();
    await page.keyboard.press('Home');
    assert.notEqual(await clipped(), half);
    assert.equal(await page.evaluate(() => window.splatbus.rig.goal.yaw), kStart.yaw, 'the slider does not turn the camera');
    // Of a view that is no more nothing is shown; of the next one again.
    await page.evaluate(() => window.splatbus.rig.zoom(0.8));
    await page.waitForFunction(() => !window.splatbus.extras.comparison.quality && document.querySelector('.compare canvas').hidden);
    await page.waitForFunction(() => window.splatbus.extras.comparison.quality && !document.querySelector('.compare canvas').hidden);
    await page.keyboard.press('m');
    await page.keyboard.press('Escape');
    await page.getByRole('dialog').waitFor({ state: 'hidden' });
    assert.ok(await page.evaluate(() => window.splatbus.extras.comparison.on), 'the menu goes first');
    await page.keyboard.press('Escape');
    await page.waitForFunction(() => !window.splatbus.extras.comparison.on);
    await page.keyboard.press('Escape');
    assert.equal(await page.evaluate(() => window.splatbus.extras.comparison.on), false);
  }, { before: answering('**/status', (route) => {
    const answer = () => route.fulfill({ json: { rights } });
    return held ? void held.push(answer) : answer();
  }) });
});

test('the model is downloaded as a file, or it is said that there is none', () => {
  let forbidden = (route) => route.fulfill({ status: 403, body: 'not for this token' });
  const body = (route) => (route.request().headers().authorization === 'Bearer abc' ? 'a model' : 'no token');
  return opened(`index.html?token=abc#${view(kStart)}`, async (page) => {
    await page.keyboard.press('m');
    const download = page.waitForEvent('download');
    await page.getByRole('button', { name: '.glb' }).click();
    const file = await download;
    assert.equal(file.suggestedFilename(), 'splatbus.glb');
    assert.equal(readFileSync(await file.path(), 'utf8'), 'a model');
    await page.getByRole('button', { name: '.spz' }).click();
    const says = (text) => page.waitForFunction((part) => document.querySelector('.notice').textContent.includes(part), text);
    await says('not offer this file');
    await page.getByRole('button', { name: '.ply' }).click();
    await says('may not download');
    forbidden = (route) => route.abort();
    await page.getByRole('button', { name: '.ply' }).click();
    await says('does not answer');
  }, { before: async (page) => {
    await page.route('**/model.glb', (route) => route.fulfill({ body: body(route) }));
    await page.route('**/model.ply', (route) => forbidden(route));
  } });
});
