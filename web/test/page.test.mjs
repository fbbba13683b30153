// The page with a stream that a test makes: how a person steers it, and what it does when something is lost.
import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';
import { after, before, test } from 'node:test';
import { launch, serve } from './browser.mjs';

const kPages = process.env.SPLATBUS_WEB_TESTS ?? '../build/release/web-tests';
const kSite = process.env.SPLATBUS_WEB ?? '../build/release/share/splatbus/web';
let browser;
let server;
const posted = [];
before(async () => {
  server = await serve([kPages, kSite], posted);
  browser = await launch();
});
after(async () => {
  await browser?.close();
  server?.close();
});

/** The page, once it shows the scene at rest. */
async function opened(path, run, { init = () => {}, ...options } = {}) {
  const context = await browser.newContext({ viewport: { width: 320, height: 200 }, ...options });
  const page = await context.newPage();
  page.setDefaultTimeout(90_000);
  await page.addInitScript(init);
  const errors = [];
  page.on('pageerror', (error) => errors.push(String(error)));
  try {
    await page.goto(`${server.url}/${path}`);
    await page.waitForFunction(() => window.splatbus?.stage.standing);
    await run(page);
    assert.deepEqual(errors, []);
  } finally {
    await context.close();
  }
}

/** Waits until the camera is to be as this says, to a millionth; input arrives with frames. */
const reaches = (page, wanted) =>
  page.waitForFunction((pose) => Object.entries(pose).every(([key, value]) => Math.abs(window.splatbus.rig.goal[key] - value) < 1e-6), wanted);
const goal = (page) => page.evaluate(() => window.splatbus.rig.goal);
const kStart = { target: [0, 0, 0], yaw: 1, pitch: 0.5, distance: 4 };
const view = (pose) => `view=${[...pose.target, pose.yaw, pose.pitch, pose.distance]}`;
const kPage = `index.html#${view(kStart)}`;

/** Colors of the canvas that draws, as the screen would show them. */
const shownColors = async (page) => {
  const png = await page.screenshot({ clip: { x: 60, y: 60, width: 200, height: 100 } });
  return page.evaluate(async (base64) => {
    const bitmap = await createImageBitmap(await (await fetch(`data:image/png;base64,${base64}`)).blob());
    const canvas = new OffscreenCanvas(bitmap.width, bitmap.height);
    const context = canvas.getContext('2d');
    context.drawImage(bitmap, 0, 0);
    const { data } = context.getImageData(0, 0, bitmap.width, bitmap.height);
    return new Set(new Uint32Array(data.buffer)).size;
  }, png.toString('base64'));
};

test('keys fly and turn, F shows all', () =>
  opened(kPage, async (page) => {
    const held = async (key, until) => {
      await page.keyboard.down(key);
      await page.waitForFunction(until);
      await page.keyboard.up(key);
    };
    await held('w', () => Math.hypot(window.splatbus.rig.goal.target[0], window.splatbus.rig.goal.target[2]) > 0.2);
    const ahead = await goal(page);
    // Towards where the camera looks, on the level.
    assert.ok(Math.abs(Math.atan2(-ahead.target[2], -ahead.target[0]) - kStart.yaw) < 1e-6);
    assert.equal(ahead.target[1], 0);
    await held('e', () => window.splatbus.rig.goal.target[1] > 0.1);
    await held('ArrowRight', () => window.splatbus.rig.goal.yaw > 1.1);
    const before = await goal(page);
    await held('d', () => window.splatbus.rig.goal.target[0] > 0);
    assert.equal((await goal(page)).distance, before.distance);
    await page.keyboard.press('f');
    await page.waitForFunction((distance) => window.splatbus.rig.goal.distance !== distance, before.distance);
    const all = await goal(page);
    assert.ok(Math.hypot(...all.target) < 1, `the middle of all is ${all.target}`);
    assert.ok(all.distance > 3 && all.distance < 8, `all is seen from ${all.distance} m`);
  }));

test('the mouse orbits, pans and zooms', () =>
  opened(kPage, async (page) => {
    await page.mouse.move(160, 100);
    await page.mouse.down();
    await page.mouse.move(210, 80, { steps: 4 });
    await page.mouse.up();
    await reaches(page, { yaw: kStart.yaw + 50 * 0.006, pitch: kStart.pitch - 20 * 0.006 });
    await page.mouse.down({ button: 'right' });
    await page.mouse.move(180, 80);
    await page.mouse.up({ button: 'right' });
    // 30 pixels to the left at the target's distance.
    const metres = (30 * kStart.distance) / (200 / (2 * Math.tan(Math.PI / 6)));
    await page.waitForFunction((far) => Math.abs(Math.hypot(...window.splatbus.rig.goal.target) - far) < 1e-6, metres);
    await page.mouse.wheel(0, -100);
    await reaches(page, { distance: 3.6 });
  }));

test('one finger orbits, two pinch and pan, a stick moves', () =>
  opened(
    kPage,
    async (page) => {
      const session = await page.context().newCDPSession(page);
      const touch = (type, ...points) =>
        session.send('Input.dispatchTouchEvent', { type, touchPoints: points.map(([x, y], id) => ({ x, y, id })) });
      await touch('touchStart', [160, 100]);
      await touch('touchMove', [180, 110]);
      await touch('touchEnd');
      await reaches(page, { yaw: kStart.yaw + 20 * 0.006 });
      await touch('touchStart', [200, 100], [240, 100]);
      await touch('touchMove', [180, 100], [260, 100]);
      await touch('touchEnd');
      // Twice as far apart.
      await reaches(page, { distance: 2 });
      const pinched = await goal(page);
      assert.ok(Math.hypot(...pinched.target) < 0.1, 'a pinch about the middle does not pan');
      const stick = await page.locator('.stick').boundingBox();
      const middle = [stick.x + stick.width / 2, stick.y + stick.height / 2];
      await touch('touchStart', middle);
      await touch('touchMove', [middle[0], middle[1] - 60]);
      await page.waitForFunction((x) => Math.abs(window.splatbus.rig.goal.target[0] - x) > 0.1, pinched.target[0]);
      await touch('touchEnd');
      const flown = await goal(page);
      const [dx, , dz] = flown.target.map((value, k) => value - pinched.target[k]);
      assert.ok(Math.abs(Math.atan2(-dz, -dx) - flown.yaw) < 1e-6);
    },
    { hasTouch: true },
  ));

test('a gamepad flies, turns and shows all', () =>
  opened(kPage, async (page) => {
    const pad = (axes, pressed = false) =>
      page.evaluate(
        ([values, value]) => {
          const buttons = Array.from({ length: 16 }, (_, index) => ({ value: index === 0 ? value : 0 }));
          navigator.getGamepads = () => [{ connected: true, axes: values, buttons }];
        },
        [axes, Number(pressed)],
      );
    await pad([0.05, -1, 0, 0]); // what a stick at rest says of itself does not count
    await page.waitForFunction(() => Math.hypot(window.splatbus.rig.goal.target[0], window.splatbus.rig.goal.target[2]) > 0.2);
    const ahead = await goal(page);
    assert.ok(Math.abs(Math.atan2(-ahead.target[2], -ahead.target[0]) - kStart.yaw) < 1e-6);
    await pad([0, 0, 1, 0]);
    await page.waitForFunction((yaw) => window.splatbus.rig.goal.yaw > yaw + 0.05, kStart.yaw);
    await pad([0, 0, 0, 0], true);
    await page.waitForFunction(() => window.splatbus.rig.goal.distance > 4.01);
  }));

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

test('a lost context comes back, and the last picture stands meanwhile', () =>
  opened(kPage, async (page) => {
    await page.waitForFunction(() => window.splatbus.stage.element.querySelector('canvas[hidden]')?.width > 300);
    const before = await shownColors(page);
    assert.ok(before > 500, `${before} colors`);
    // Asked at the moment of the loss: another context may be there before the test looks.
    const stands = await page.evaluate(async () => {
      const { stage } = window.splatbus;
      const { renderer } = stage;
      renderer.dispose();
      await renderer.lost;
      const still = [...stage.element.querySelectorAll('canvas')].at(-1);
      const { data } = still.getContext('2d').getImageData(60, 60, 200, 100);
      return { lost: stage.renderer === null, shown: !still.hidden, colors: new Set(new Uint32Array(data.buffer)).size };
    });
    assert.ok(stands.lost && stands.shown && stands.colors > 500, JSON.stringify(stands));
    await page.waitForFunction(() => window.splatbus.stage.renderer && window.splatbus.stage.uploadedRows === 6000);
    await page.waitForFunction(() => window.splatbus.stage.element.querySelector('canvas[hidden]'));
    assert.ok((await shownColors(page)) > 500, 'it is drawn again');
  }));

test('a worker that dies is started again, and the picture stands', () =>
  opened(kPage, async (page) => {
    await page.evaluate(() => window.splatbus.link.kill());
    assert.ok((await shownColors(page)) > 500);
    await page.waitForFunction(() => window.splatbus.stage.uploadedRows === 6000);
    assert.ok((await shownColors(page)) > 500);
  }));

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

test('G follows the player where there is one, until somebody steers', () =>
  opened(kPage, async (page) => {
    const says = (text) => page.waitForFunction((part) => document.querySelector('.notice').textContent.includes(part), text);
    await page.keyboard.press('g');
    await says('no player');
    assert.deepEqual(await goal(page), kStart);
    await page.keyboard.press('m');
    const entry = page.getByRole('button', { name: 'Follow the player' });
    assert.equal(await entry.isVisible(), false);
    // From (0, 1, 3) along -z, then along -x and down.
    const player = (camera) => page.evaluate((transform) => new BroadcastChannel('player').postMessage(transform), camera);
    await player([1, 0, 0, 0, 0, -1, 0, 1, 0, 0, -1, 3]);
    await entry.click();
    await says('Following');
    const stands = (eye, yaw, pitch) =>
      page.waitForFunction(
        ([[x, y, z], wantedYaw, wantedPitch]) => {
          const { target, yaw, pitch, distance } = window.splatbus.rig.shown;
          const at = [target[0] + distance * Math.cos(pitch) * Math.cos(yaw), target[1] + distance * Math.sin(pitch), target[2] + distance * Math.cos(pitch) * Math.sin(yaw)];
          const off = Math.hypot(at[0] - x, at[1] - y, at[2] - z) + Math.abs(Math.sin((yaw - wantedYaw) / 2)) + Math.abs(pitch - wantedPitch);
          return off < 1e-4;
        },
        [eye, yaw, pitch],
      );
    await stands([0, 1, 3], Math.PI / 2, 0);
    const [c, s] = [Math.cos(0.3), Math.sin(0.3)];
    await player([0, s, -c, 2, 0, -c, -s, 1.5, -1, 0, 0, 0]);
    await stands([2, 1.5, 0], 0, 0.3);
    await page.waitForFunction(() => document.querySelector('[aria-pressed]').getAttribute('aria-pressed') === 'true');
    await page.keyboard.press('Escape');
    await page.mouse.move(160, 100);
    await page.mouse.wheel(0, -100);
    await page.waitForFunction((distance) => window.splatbus.rig.goal.distance < distance, kStart.distance);
    await page.waitForFunction(() => document.querySelector('[aria-pressed]').getAttribute('aria-pressed') === 'false');
    const left = await goal(page);
    await player([1, 0, 0, 0, 0, -1, 0, 1, 0, 0, -1, 3]);
    await page.waitForFunction(() => window.splatbus.stage.scene.transforms.at(-1) === 3);
    assert.deepEqual(await goal(page), left);
    await player(null);
    await page.waitForFunction(() => document.querySelector('[aria-pressed]').hidden);
  }));

test('who is not let in is told so, and not that nobody is there', () =>
  opened(`index.html?token=abc#${view(kStart)}`, async (page) => {
    const says = (text) => page.waitForFunction((part) => document.querySelector('.notice').textContent.includes(part), text);
    const lost = (retryS) => page.evaluate((seconds) => new BroadcastChannel('connection').postMessage(seconds), retryS);
    await page.route('**/status', (route) => route.abort());
    await lost(30);
    await says('No connection. Trying again in');
    await page.waitForFunction(() => document.querySelector('[data-figure=connection]').textContent === 'Lost');
    await page.keyboard.press('c');
    await says('does not answer');
    await page.unroute('**/status');
    await page.route('**/status', (route) => route.fulfill({ status: 401, body: 'a token is needed' }));
    await lost(30);
    await says('does not accept the token');
    assert.ok((await shownColors(page)) > 500, 'the picture stands');
    await lost(0);
    await page.waitForFunction(() => document.querySelector('.notice').textContent === '');
  }));

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

test('a flight is measured, shown and posted', () =>
  opened(`${kPage.replace('#', '?bench=1&seconds=3#')}`, async (page) => {
    await page.waitForFunction(() => document.body.dataset.bench);
    const shown = JSON.parse(await page.evaluate(() => document.body.dataset.bench));
    const { path, body } = posted.at(-1);
    assert.equal(path, '/bench');
    assert.deepEqual(JSON.parse(body), shown);
    assert.ok(shown.frames > 5 && shown.medianMs > 0 && shown.gaussians === 3000, body);
  }));

test('a slider between the engine\'s own picture and the splats, and how alike they are', () =>
  opened(`${kPage.replace('index.html', 'index.html?gpu=webgl2')}`, async (page) => {
    await page.route('**/status', (route) => route.fulfill({ json: { rights: 'view' } }));
    await page.keyboard.press('c');
    await page.waitForFunction(() => document.querySelector('.notice').textContent.includes('may not'));
    await page.unroute('**/status');
    await page.route('**/status', (route) => route.fulfill({ json: { rights: 'view,probe' } }));
    await page.evaluate(() => {
      const label = document.querySelector('.compare .right');
      const stop = new MutationObserver(() => (window.namedEarly ??= getComputedStyle(label).display !== 'none' && document.querySelector('.compare canvas').hidden));
      stop.observe(document.querySelector('.compare'), { attributes: true });
    });
    await page.keyboard.press('c');
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
    await page.keyboard.press('c');
    await page.waitForFunction(() => !window.splatbus.extras.comparison.on);
  }));

test('the model is downloaded as a file, or it is said that there is none', () =>
  opened(`index.html?token=abc#${view(kStart)}`, async (page) => {
    await page.route('**/model.glb', (route) =>
      route.fulfill({ body: route.request().headers().authorization === 'Bearer abc' ? 'a model' : 'no token' }),
    );
    await page.keyboard.press('m');
    const download = page.waitForEvent('download');
    await page.getByRole('button', { name: '.glb' }).click();
    const file = await download;
    assert.equal(file.suggestedFilename(), 'splatbus.glb');
    assert.equal(readFileSync(await file.path(), 'utf8'), 'a model');
    await page.getByRole('button', { name: '.spz' }).click();
    await page.waitForFunction(() => document.querySelector('.notice').textContent.includes('no such file'));
  }));

/** A headset that is none: two eyes beside one another in a texture, 64 mm apart, that looks where the test says. */
function emulateXr() {
  const kEye = 128;
  const xr = { yaw: 0, ended: false, lower: null };
  const matrix = (x) => {
    const [c, s] = [Math.cos(xr.yaw), Math.sin(xr.yaw)];
    const [px, py, pz] = [x * c, 0, -x * s];
    const m = new Float32Array([c, 0, -s, 0, 0, 1, 0, 0, s, 0, c, 0, px, py, pz, 1]);
    const inverse = new Float32Array([c, 0, s, 0, 0, 1, 0, 0, -s, 0, c, 0, -(c * px - s * pz), -py, -(s * px + c * pz), 1]);
    return { matrix: m, inverse: { matrix: inverse, inverse: null } };
  };
  // An eye sees further outwards than towards the nose.
  const projection = (skew) => new Float32Array([1.2, 0, 0, 0, 0, 1.1, 0, 0, skew, 0.05, -1, -1, 0, 0, -0.1, 0]);
  class Session extends EventTarget {
    inputSources = [];
    updateRenderState() {}
    async requestReferenceSpace() {
      return new EventTarget();
    }
    requestAnimationFrame(callback) {
      return requestAnimationFrame((now) => {
        if (xr.ended) return;
        const views = [
          { eye: 'left', transform: matrix(-0.032), projectionMatrix: projection(-0.1) },
          { eye: 'right', transform: matrix(0.032), projectionMatrix: projection(0.1) },
        ];
        callback(now, { getViewerPose: () => ({ transform: matrix(0), views }) });
      });
    }
    async end() {
      xr.ended = true;
      this.dispatchEvent(new Event('end'));
    }
  }
  window.XRWebGLLayer = class {
    constructor(session, gl) {
      const texture = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA8, 2 * kEye, kEye);
      this.framebuffer = gl.createFramebuffer();
      gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
      gl.makeXRCompatible = async () => {};
      xr.pixels = (x) => {
        const out = new Uint8Array(4 * kEye * kEye);
        gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
        gl.readPixels(x, 0, kEye, kEye, gl.RGBA, gl.UNSIGNED_BYTE, out);
        return out;
      };
    }
    getViewport({ eye }) {
      return { x: eye === 'left' ? 0 : kEye, y: 0, width: kEye, height: kEye };
    }
  };
  WebGL2RenderingContext.prototype.makeXRCompatible = async () => {};
  Object.defineProperty(navigator, 'xr', { value: { isSessionSupported: async () => true, requestSession: async () => (xr.session = new Session()) } });
  window.xr = xr;
}

test('a headset is given both eyes of one sort, and the page goes on when it is taken off', () =>
  opened(
    `index.html?gpu=webgl2#${view(kStart)}`,
    async (page) => {
      await page.keyboard.press('m');
      await page.getByRole('button', { name: 'Headset' }).click();
      await page.waitForFunction(() => window.splatbus.extras.immersion && window.splatbus.frames > 20);
      // What the page itself shows from where an eye is, by our own camera of the same place.
      const eyes = await page.evaluate(async (start) => {
        const { stage } = window.splatbus;
        const kEye = 128;
        const eye = [0, 1, 2].map((k) => [Math.cos(start.pitch) * Math.cos(start.yaw), Math.sin(start.pitch), Math.cos(start.pitch) * Math.sin(start.yaw)][k] * start.distance);
        const forward = [-Math.cos(start.yaw), 0, -Math.sin(start.yaw)];
        const right = [Math.sin(start.yaw), 0, -Math.cos(start.yaw)];
        const results = [];
        for (const [side, skew] of [[-1, -0.1], [1, 0.1]]) {
          const at = eye.map((value, k) => value + 0.032 * side * right[k]);
          const dot = (axis) => -axis.reduce((sum, value, k) => sum + value * at[k], 0);
          const viewFromWorld = new Float64Array([...right, dot(right), 0, -1, 0, at[1], ...forward, dot(forward), 0, 0, 0, 1]);
          const view = { viewFromWorld, fx: 0.6 * kEye, fy: 0.55 * kEye, cx: ((1 - skew) * kEye) / 2, cy: (1.05 * kEye) / 2, width: kEye, height: kEye };
          const expected = await stage.renderer.capture({ view, scene: stage.scene, resolution: 1, timeS: 1e6 });
          const drawn = window.xr.pixels(side < 0 ? 0 : kEye);
          let different = 0;
          let colors = new Set();
          for (let y = 0; y < kEye; ++y) {
            for (let i = 0; i < 4 * kEye; ++i) {
              const ours = drawn[4 * kEye * (kEye - 1 - y) + i];
              if (i % 4 === 0) colors.add(ours);
              different = Math.max(different, Math.abs(ours - expected.rgba[4 * kEye * y + i]));
            }
          }
          results.push({ different, colors: colors.size });
        }
        const [left, right_] = [window.xr.pixels(0), window.xr.pixels(kEye)];
        return { results, disparate: left.filter((value, i) => Math.abs(value - right_[i]) > 8).length };
      }, kStart);
      for (const { different, colors } of eyes.results) {
        assert.ok(different <= 2, `an eye differs by ${different}`);
        assert.ok(colors > 20, 'there is something to see');
      }
      assert.ok(eyes.disparate > 100, 'the eyes see it from two places');
      // A head that turns about turns its back on the scene.
      await page.evaluate(() => (window.xr.yaw = Math.PI));
      await page.waitForFunction(() => new Set(window.xr.pixels(0)).size < 8);
      const before = await page.evaluate(() => window.splatbus.frames);
      await page.evaluate(() => window.splatbus.extras.immersion.end());
      await page.waitForFunction(() => !window.splatbus.extras.immersion);
      await page.evaluate(() => window.splatbus.rig.zoom(0.9));
      await page.waitForFunction((frames) => window.splatbus.frames > frames, before);
    },
    { init: emulateXr },
  ));
