// A headset, emulated: both eyes of one sort.
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { kStart, opened, view } from './opened_page.mjs';

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
