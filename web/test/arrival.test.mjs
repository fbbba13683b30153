// What the page shows of a model that is still coming, with clocks that the tests make.
import assert from 'node:assert/strict';
import { resolve } from 'node:path';
import { test } from 'node:test';
import { pathToFileURL } from 'node:url';

const kPages = process.env.SPLATBUS_WEB_TESTS ?? '../build/release/web-tests';
const logic = await import(pathToFileURL(resolve(kPages, 'logic.js')));

/** When it is said first that no more comes, of figures every 250 ms; null: never. */
function settledAt(missingAt, { untilMs = 60_000, ...others } = {}) {
  const arrival = new logic.Arrival();
  for (let atMs = 0; atMs <= untilMs; atMs += 250) {
    const { open = true, gaussians = 9, epoch = 1 } = others.at?.(atMs) ?? {};
    if (arrival.settled({ gaussians, epoch, missing: missingAt(atMs) }, open, atMs)) return atMs;
  }
  return null;
}

test('all has come that is to come when nothing is missing, or when nothing more has come for five seconds', () => {
  assert.equal(settledAt((ms) => Math.max(0, 40 - ms / 250)), 10_000, 'as soon as it is whole');
  // A world beyond the budget: ten pages come, one every two seconds; then 90 are missing, now and then a few more.
  assert.equal(settledAt((ms) => Math.max(90, 100 - Math.floor(ms / 2000)) + (ms > 20_000 ? (ms / 250) % 3 : 0)), 25_000);
  assert.equal(settledAt(() => -1), null, 'nobody knows of how many pages');
  assert.equal(settledAt(() => 0, { at: () => ({ gaussians: 0 }) }), null, 'of nothing');
  // While there is no connection nothing comes that may come yet; another model begins anew.
  assert.equal(settledAt(() => 50, { at: (ms) => ({ open: ms >= 12_000 }) }), 17_000);
  assert.equal(settledAt(() => 50, { at: (ms) => ({ epoch: ms < 4000 ? 1 : 2 }) }), 9000);
});

/** A viewer of a world that arrives: what its camera is asked to frame at every turn of a display. */
function framed(figuresAt, spheres, { seconds = 20, steersAtS = Infinity } = {}) {
  const framing = new logic.Framing();
  const shown = [];
  let asks = 0;
  for (let ms = 0; ms < 1000 * seconds; ms += 20) {
    if (ms >= 1000 * steersAtS) framing.end();
    const figures = figuresAt(ms);
    if (ms % 260 === 0 && framing.asks(figures, figures.missing === 0, ms)) {
      ++asks;
      const { centre, radius } = spheres(figures.gaussians);
      assert.ok(framing.takes(centre, radius));
    }
    const sphere = framing.advance(0.02);
    if (sphere) shown.push({ ms, ...sphere });
  }
  return { asks, shown };
}
/** The world grows to the right as more of it comes: 1000 Gaussians a metre. */
const kGrowing = (gaussians) => ({ centre: [gaussians / 1000, 0, 0], radius: 1 + gaussians / 500 });

test('what is framed grows with what has come, without a jump, until all of it is there', () => {
  const { asks, shown } = framed((ms) => ({ gaussians: Math.min(10_000, 500 + Math.floor(ms)), missing: ms < 9500 ? 1 : 0 }), kGrowing);
  assert.deepEqual([shown[0].ms, ...shown[0].centre], [0, 0.5, 0, 0], 'the first at once');
  let before = shown[0];
  for (const now of shown.slice(1)) {
    assert.ok(now.centre[0] >= before.centre[0] && now.centre[0] - before.centre[0] < 0.15, `a step of ${now.centre[0] - before.centre[0]} m at ${now.ms} ms`);
    assert.ok(now.radius >= before.radius && now.radius - before.radius < 0.3, `${now.radius - before.radius} m more at ${now.ms} ms`);
    before = now;
  }
  assert.deepEqual([...before.centre, before.radius], [10, 0, 0, 21]);
  assert.ok(asks >= 9 && asks <= 22, `asked ${asks} times`);
  // What comes later of a model that was whole is not framed.
  const later = framed((ms) => ({ gaussians: ms < 5000 ? 1000 : 9000, missing: 0 }), kGrowing);
  assert.deepEqual([later.asks, later.shown.at(-1).centre[0]], [2, 1]);
  // What is said to be whole before who knows the bounds has all of it.
  let held = 0;
  const slow = framed(() => ({ gaussians: 9000, missing: 0 }), () => kGrowing((held = Math.min(9000, held + 3000))));
  assert.equal(slow.shown.at(-1).centre[0], 9);
});

test('a world in which something large never rests is not followed for ever', () => {
  let turns = 0;
  const moves = () => ({ centre: [Math.sin(++turns), 0, 0], radius: 3 }); // a third of the radius each time
  const { asks, shown } = framed((ms) => ({ gaussians: 9000, missing: ms < 3000 ? 1 : 0 }), moves, { seconds: 60 });
  assert.ok(shown.at(-1).ms > 6000 && shown.at(-1).ms < 12_000, `the last at ${shown.at(-1).ms} ms: four seconds after all was there, and what the way takes`);
  assert.ok(asks < 12, `asked ${asks} times`);
});

test('who steers is not moved by what comes', () => {
  const { shown } = framed((ms) => ({ gaussians: 500 + ms, missing: 1 }), kGrowing, { steersAtS: 3 });
  assert.ok(shown.at(-1).ms < 3000, `${shown.at(-1).ms} ms`);
  const framing = new logic.Framing();
  assert.equal(framing.takes([0, 0, 0], 1), false, 'who asks by a key is shown it by the camera itself');
});
