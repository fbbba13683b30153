// A headset, emulated: both eyes of one sort.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { drawsBy, goal, kStart, opened, says, view } from './opened_page.mjs';

/** A headset that is none: two eyes beside one another in a texture, 64 mm apart, that looks where the test says. */
function emulateXr() {
  const kEye = 128;
  const xr = { yaw: 0, ended: false, lower: null, layers: true };
  // A machine of two GPUs: the headset hangs on the one that a page is not given unasked.
  const compatible = new WeakSet();
  const { getContext } = HTMLCanvasElement.prototype;
  HTMLCanvasElement.prototype.getContext = function (kind, asked) {
    const context = getContext.call(this, kind, asked);
    if (asked?.xrCompatible) compatible.add(context);
    return context;
  };
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
      if (!xr.layers) throw new Error('no layer');
      const texture = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA8, 2 * kEye, kEye);
      this.framebuffer = gl.createFramebuffer();
      gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
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
  WebGL2RenderingContext.prototype.makeXRCompatible = async function () {
    if (!compatible.has(this)) this.getExtension('WEBGL_lose_context').loseContext();
  };
  const requestSession = async () => {
    xr.ended = false;
    return (xr.session = new Session());
  };
  Object.defineProperty(navigator, 'xr', { value: { isSessionSupported: async () => true, requestSession } });
  window.xr = xr;
}

const kQuality = (quality) => (page) =>
  page.addInitScript((chosen) => localStorage.setItem('splatbus.settings', JSON.stringify({ quality: chosen })), quality);
const putOn = async (page) => {
  await page.evaluate(() => document.querySelector('.menu').open || document.querySelector('.menu').show());
  await page.getByRole('button', { name: 'Headset' }).click();
};
const isOn = (page) => page.waitForFunction(() => window.splatbus.extras.immersion && window.xr.pixels);

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
          const expected = await stage.renderer.capture({ view, scene: stage.scene, resolution: 1, timeS: 1e6, mip: true });
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
      // What leans down is the camera that the page had, and no head: a stick moves on the level.
      await page.evaluate(() => (window.xr.session.inputSources = [{ handedness: 'left', gamepad: { axes: [0, 0, 0, -1], buttons: [] } }]));
      await page.waitForFunction(() => Math.hypot(window.splatbus.rig.goal.target[0], window.splatbus.rig.goal.target[2]) > 0.2);
      assert.ok(Math.abs((await goal(page)).target[1]) < 1e-9);
      await page.evaluate(() => (window.xr.session.inputSources = []));
      const before = await page.evaluate(() => window.splatbus.frames);
      await page.evaluate(() => window.splatbus.extras.immersion.end());
      await page.waitForFunction(() => !window.splatbus.extras.immersion);
      await page.evaluate(() => window.splatbus.rig.zoom(0.9));
      await page.waitForFunction((frames) => window.splatbus.frames > frames, before);
    },
    { init: emulateXr, before: kQuality('full') },
  ));

test('a headset is drawn for as finely as the menu says', () =>
  opened(
    `index.html?gpu=webgl2#${view(kStart)}`,
    async (page) => {
      await putOn(page);
      await isOn(page);
      const drawn = await page.evaluate(async () => {
        const resolutions = new Set();
        const { renderer } = window.splatbus.stage;
        const drawEyes = renderer.drawEyes.bind(renderer);
        renderer.drawEyes = (target, eyes, frame) => {
          resolutions.add(frame.resolution);
          drawEyes(target, eyes, frame);
        };
        while (resolutions.size === 0) await new Promise(requestAnimationFrame);
        return [...resolutions];
      });
      assert.deepEqual(drawn, [0.35]);
    },
    { init: emulateXr, before: kQuality('low') },
  ));

test('who has WebGPU has it again after a headset, and after one that could not be used', () =>
  opened(
    `index.html?gpu=webgpu#${view(kStart)}`,
    async (page) => {
      await drawsBy(page, 'webgpu');
      await page.evaluate(() => (window.xr.layers = false));
      await putOn(page);
      await says(page, 'The headset cannot be used: no layer');
      await drawsBy(page, 'webgpu');
      await page.evaluate(() => (window.xr.layers = true));
      await putOn(page);
      await isOn(page);
      assert.equal(await page.evaluate(() => window.splatbus.stage.renderer.api), 'webgl2');
      await page.waitForFunction(() => new Set(window.xr.pixels(0)).size > 20);
      await page.evaluate(() => window.splatbus.extras.immersion.end());
      await drawsBy(page, 'webgpu');
    },
    { init: emulateXr },
  ));

test('a headset whose device is lost is said to be so, and can be put on again', () =>
  opened(
    `index.html?gpu=webgl2#${view(kStart)}`,
    async (page) => {
      await putOn(page);
      await isOn(page);
      await page.evaluate(() => window.splatbus.stage.renderer.dispose());
      await says(page, 'The headset cannot be used: the graphics device was lost');
      await page.waitForFunction(() => !window.splatbus.extras.immersion);
      await drawsBy(page, 'webgl2');
      await putOn(page);
      await isOn(page);
      await page.waitForFunction(() => new Set(window.xr.pixels(0)).size > 20);
    },
    { init: emulateXr },
  ));

test('of two that are started at once one draws, and the other is given back', () =>
  opened(
    `index.html?gpu=webgpu#${view(kStart)}`,
    async (page) => {
      await drawsBy(page, 'webgpu');
      const left = await page.evaluate(async () => {
        const { stage } = window.splatbus;
        const devices = [];
        const { requestDevice } = GPUAdapter.prototype;
        GPUAdapter.prototype.requestDevice = async function (...given) {
          devices.push(await requestDevice.apply(this, given));
          return devices.at(-1);
        };
        const first = stage.start();
        await Promise.all([stage.lend(), first]);
        const lost = await Promise.all(devices.map(({ lost }) => Promise.race([lost.then(() => true), new Promise((resolve) => setTimeout(resolve, 20_000, false))])));
        return { lost, api: stage.renderer.api, canvases: stage.element.querySelectorAll('canvas').length };
      });
      assert.deepEqual(left, { lost: [true], api: 'webgl2', canvases: 1 });
    },
    { init: emulateXr },
  ));
