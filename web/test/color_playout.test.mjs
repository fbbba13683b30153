// When colors that come with scenes are shown, on scripted clocks and then on a page.
import assert from 'node:assert/strict';
import { resolve } from 'node:path';
import { test } from 'node:test';
import { pathToFileURL } from 'node:url';
import { kPage, opened } from './opened_page.mjs';

const kPages = process.env.SPLATBUS_WEB_TESTS ?? '../build/release/web-tests';
const { ColorPlayout, Playout } = await import(pathToFileURL(resolve(kPages, 'logic.js')));

/** What a renderer does with colors, of one number each. */
class Holder {
  now = new Map();
  kept = new Map();
  recolored = 0;

  recolor({ rows, colors }) {
    rows.forEach((row, index) => this.now.set(row, colors[index]));
    this.recolored += rows.length;
  }
  keepColors() {
    this.kept = new Map(this.now);
  }
  write(row, color) {
    this.now.set(row, color);
    this.kept.set(row, color);
  }
  shown(row, part) {
    return this.kept.get(row) + part * (this.now.get(row) - this.kept.get(row));
  }
}

const update = (colors) => ({ rows: Uint32Array.from(Object.keys(colors), Number), colors: Uint32Array.from(Object.values(colors)) });

/** Rows 0 to 9 at 100, of a scene at 1000 ms, which is shown. */
function begun() {
  const [playout, holder] = [new ColorPlayout(), new Holder()];
  for (let row = 0; row < 10; ++row) holder.write(row, 100);
  playout.restart(1000);
  playout.advance(980, holder);
  return {
    playout,
    holder,
    add: (colors, ofMs, sceneMs = ofMs) => playout.add(update(colors), ofMs, sceneMs),
    wrote(row, color) {
      holder.write(row, color);
      playout.wrote(Uint32Array.of(row));
    },
    at(ms, row = 0) {
      playout.advance(ms, holder);
      return holder.shown(row, playout.part);
    },
  };
}

test('before its scene is played out the older colors are shown, half way the mean of both', () => {
  const { at, add, holder, playout } = begun();
  add({ 0: 200 }, 1100);
  assert.equal(at(990), 100);
  assert.equal(holder.recolored, 0, 'it waits');
  assert.ok(playout.moving);
  assert.equal(at(1000), 100);
  assert.equal(at(1050), 150);
  assert.equal(at(1050, 1), 100, 'what has not changed stays');
  add({ 0: 400 }, 1200);
  assert.equal(at(1075), 175);
  assert.equal(at(1110), 220);
  assert.equal(at(1150), 300);
  assert.ok(playout.moving);
  assert.equal(at(1200), 400);
  assert.ok(!playout.moving);
});

test('where frames are rarer than scenes none is left out', () => {
  const { at, add } = begun();
  add({ 0: 200, 1: 300 }, 1033);
  add({ 0: 300 }, 1066);
  add({ 0: 400 }, 1100);
  assert.equal(at(1083), 350);
  assert.equal(at(1083, 1), 300);
});

test('colors of one scene that come in parts belong together', () => {
  const { at, add } = begun();
  add({ 0: 200 }, 1100);
  add({ 1: 200 }, 1100);
  assert.equal(at(1050), 150);
  assert.equal(at(1050, 1), 150);
  add({ 2: 200 }, 1100);
  assert.equal(at(1060, 2), 160, 'what comes late is where it would have been');
  assert.equal(at(1100, 2), 200);
});

test('colors that come late do not jump', () => {
  const { at, add } = begun();
  assert.equal(at(1040), 100);
  add({ 0: 200 }, 1100);
  assert.equal(at(1040), 100);
  assert.equal(at(1070), 150, 'half of what was left of the way');
  assert.equal(at(1100), 200);
});

test('a row that was written is not recolored by what waited before', () => {
  const { at, add, wrote } = begun();
  add({ 0: 200, 1: 200 }, 1100);
  wrote(0, 900);
  assert.equal(at(1050), 900);
  assert.equal(at(1050, 1), 150);
  assert.equal(at(1100), 900);
  add({ 0: 500 }, 1200, 1200);
  assert.equal(at(1200), 500, 'what is newer does');
});

test('shadows of an earlier time are shown at it, and what is lit later does not undo them', () => {
  const { at, add } = begun();
  add({ 0: 200, 1: 200 }, 1100);
  add({ 0: 50 }, 1010, 1100); // of an earlier scene, in the light of 1100
  assert.equal(at(1005), 75);
  assert.equal(at(1010), 50);
  assert.equal(at(1055), 50, 'it has the light already');
  assert.equal(at(1055, 1), 150);
  assert.equal(at(1100), 50);
  assert.equal(at(1100, 1), 200);
});

test('without a clock, of another engine, and where too many wait nothing is waited for', () => {
  const untimed = begun();
  untimed.add({ 0: 200 }, 0, 1000);
  assert.equal(untimed.at(985), 200);
  untimed.add({ 0: 300 }, 1100);
  assert.equal(untimed.at(null), 300);
  const first = new ColorPlayout();
  first.restart(0);
  first.add(update({ 0: 200 }), 0, 0);
  first.advance(null, new Holder());
  first.advance(1000, new Holder());
  assert.equal(first.part, 1);
  const another = begun();
  another.add({ 0: 200, 1: 200 }, 1100);
  another.add({ 0: 300 }, 400);
  assert.equal(another.at(400), 300);
  assert.equal(another.at(400, 1), 200, 'what waited for another time has come');
  another.add({ 0: 500 }, 500);
  assert.equal(another.at(400), 300);
  assert.equal(another.at(450), 400, 'the clock is the other one');
  const many = begun();
  for (let k = 1; k <= 100; ++k) many.add({ 0: 100 + k }, 1000 + k);
  many.at(990);
  assert.ok(many.holder.recolored >= 60, `${many.holder.recolored} recolored`);
});

test('no colors are of a later scene than the newest', () => {
  const { playout, at, add } = begun();
  add({ 0: 200 }, 90_000, 1100);
  assert.equal(at(1050), 150);
  assert.equal(at(1100), 200);
  assert.ok(!playout.moving);
  playout.restart(90_000);
  add({}, 90_000, 1200);
  assert.equal(at(1190), 200);
  add({ 0: 300 }, 1300);
  assert.equal(at(1200), 200);
  assert.equal(at(1250), 250);
});

test('no more rows wait than that in all', () => {
  const holder = new Holder();
  const playout = new ColorPlayout(5);
  playout.restart(1000);
  playout.advance(980, holder);
  for (let k = 1; k <= 5; ++k) playout.add(update({ 0: 200, 1: 300 }), 1000 + k, 1000 + k);
  playout.advance(990, holder);
  assert.equal(holder.recolored, 6, 'four of ten wait on');
  playout.advance(1005, holder);
  assert.equal(holder.recolored, 10);
});

test('a turning sun is seen in even steps, where objects are seen', () => {
  // Six scenes a second, 20 to 30 ms late, their colors as much later again; a color is the time that it is of.
  const playout = new Playout();
  const { playout: colors, holder } = begun();
  const kEngineAheadMs = 50_000;
  holder.write(0, kEngineAheadMs);
  colors.restart(kEngineAheadMs);
  const scenes = Array.from({ length: 30 }, (_, k) => ({ ms: kEngineAheadMs + 167 * k, arrivedMs: 167 * k + 20 + 5 * (k % 3) }));
  let [next, recolored, before] = [0, 0, 0];
  const steps = [];
  for (let now = 0; now < 4500; now += 1000 / 60) {
    for (; next < scenes.length && scenes[next].arrivedMs <= now; ++next) {
      playout.add({ transforms: new Float32Array(12).fill(next), background: [0, 0, 0] }, { captureMs: scenes[next].ms, arrivedMs: scenes[next].arrivedMs });
    }
    for (; recolored < next && scenes[recolored].arrivedMs + 20 <= now; ++recolored) {
      colors.add(update({ 0: scenes[recolored].ms }), scenes[recolored].ms, scenes[recolored].ms);
    }
    colors.advance(playout.timeAt(now), holder);
    const shown = holder.shown(0, colors.part);
    if (now > 1000) {
      steps.push(shown - before);
      const lag = playout.shownMs(now) - shown;
      assert.ok(Math.abs(lag) < 35, `${lag} ms behind objects at ${now} ms`);
    }
    before = shown;
  }
  assert.ok(Math.min(...steps) >= 0 && Math.max(...steps) < 30, `steps of ${Math.min(...steps)} to ${Math.max(...steps)} ms in 16.7`);
});

/** From `window.script()` on the page's frames are those that the test makes. */
function scriptFrames() {
  const real = window.requestAnimationFrame.bind(window);
  let due = null;
  window.requestAnimationFrame = (callback) => (due ? due.push(callback) : real((ms) => (due ? due.push(callback) : callback(ms))));
  const small = new OffscreenCanvas(32, 20).getContext('2d', { willReadFrequently: true });
  window.script = () => {
    due = [];
    window.taken = 0;
    const { link } = window.splatbus;
    const send = link.send.bind(link);
    link.send = (message, transfer) => {
      if (message.kind === 'taken') window.taken += message.batches;
      send(message, transfer);
    };
    return performance.now() + 1000;
  };
  /** How bright the middle of the picture is after a frame at this time: where nothing was drawn, as before. */
  let bright = 0;
  window.frame = (ms) => {
    const { frames } = window.splatbus;
    for (const callback of due.splice(0)) callback(ms);
    if (window.splatbus.frames === frames) return bright;
    small.drawImage(document.querySelector('.stage canvas'), 0, 0, 32, 20);
    const { data } = small.getImageData(8, 5, 16, 10);
    bright = data.reduce((sum, value, i) => sum + (i % 4 < 3 ? value : 0), 0) / (0.75 * data.length);
    return bright;
  };
}

for (const api of ['webgl2', 'webgpu']) {
  test(`${api}: a page goes from the light of one scene to that of the next while objects do`, () =>
    opened(
      kPage.replace('#', `?gpu=${api}#`),
      async (page) => {
        const base = await page.evaluate(() => new Promise((done) => setTimeout(() => done(window.script()), 100)));
        const frame = (ms) => page.evaluate((at) => window.frame(at), base + ms);
        const uploaded = () => page.evaluate(() => window.splatbus.stage.renderer.uploaded.bytes);
        /** A scene comes as it is, and is taken. */
        const post = async (channel, what, ms) => {
          const taken = await page.evaluate(() => window.taken);
          await page.evaluate(([name, message]) => new BroadcastChannel(name).postMessage(message), [channel, what]);
          while ((await page.evaluate(() => window.taken)) === taken) await frame(ms);
        };
        const light = (ms, part) => post('light', { ms: 5000 + ms, arrivedMs: base + ms, part }, ms);
        const first = await uploaded();
        await light(0, 0);
        const dark = await frame(0);
        // A scene lasts 200 ms: what is shown is as much behind.
        const seen = [];
        for (let ms = 0; ms <= 800; ms += 20) {
          if (ms % 200 === 0 && ms > 0 && ms <= 600) await light(ms, ms / 600);
          seen.push(await frame(ms));
        }
        const steps = seen.slice(1).map((value, k) => value - seen[k]);
        const told = seen.map(Math.round).join();
        assert.ok(seen.slice(0, 11).every((value) => value === dark), `dark until the next scene can be shown: ${told}`);
        assert.ok(steps.slice(10, -2).every((step) => step > 0), `brighter in every frame: ${told}`);
        assert.ok(seen.at(-1) > dark + 60, told);
        assert.ok(steps.slice(20).every((step) => step < (seen.at(-1) - dark) / 15), `in even steps: ${told}`);
        assert.equal(await frame(820), seen.at(-1), 'and rests then');
        assert.equal((await uploaded()) - first, 4 * 8 * 3000, 'a color of each scene and row');
        // Rows that change are not to be seen in colors from before.
        for (const ms of [900, 1000, 1100]) await light(ms, 0); // the last waits for the one before
        await post('change', 3000, 1100);
        const changed = await frame(1110);
        for (let ms = 1120; ms <= 1600; ms += 20) assert.equal(await frame(ms), changed, `at ${ms} ms`);
        assert.ok(changed > dark + 5);
      },
      { init: scriptFrames },
    ));
}
