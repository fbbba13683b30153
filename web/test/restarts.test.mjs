// How soon what has died is started again, with clocks that the tests make.
import assert from 'node:assert/strict';
import { resolve } from 'node:path';
import { mock, test } from 'node:test';
import { pathToFileURL } from 'node:url';

const kPages = process.env.SPLATBUS_WEB_TESTS ?? '../build/release/web-tests';
const logic = await import(pathToFileURL(resolve(kPages, 'logic.js')));

test('what ends soon after every start waits longer each time, until one has lived for ten seconds', () => {
  const restarts = new logic.Restarts(1, 100);
  let now = 0;
  const livesFor = (ms) => {
    restarts.started(now);
    return restarts.ended((now += ms));
  };
  const waits = Array.from({ length: 8 }, () => livesFor(9000));
  // Half as long again each time, give or take a quarter.
  waits.forEach((wait, k) => assert.ok(wait >= 0.75 * 1.5 ** k && wait <= 1.25 * 1.5 ** k, `${waits}`));
  assert.equal(restarts.inARow, 8);
  assert.ok(livesFor(10_000) <= 1.25);
  assert.equal(restarts.inARow, 1);
  restarts.ended((now += 60_000)); // it does not start at all
  assert.equal(restarts.inARow, 2);
});

test('engines\' own words for memory that is at an end are known, and a trap is none', () => {
  const said = ['RangeError: Array buffer allocation failed', 'RangeError: Invalid typed array length: 123', 'InternalError: allocation size overflow', 'uncaught exception: out of memory', 'Error: splatbus.wasm: no memory'];
  for (const reason of said) assert.ok(logic.saysOutOfMemory(reason), reason);
  for (const reason of ['RuntimeError: memory access out of bounds', 'RuntimeError: unreachable', '']) assert.ok(!logic.saysOutOfMemory(reason), reason);
});

/** A link whose workers live as `lives` says, on a clock that goes on by itself; gives what it says, and when it started workers. */
function linked(lives, untilMs) {
  let now = 0;
  const due = [];
  const later = (ms, act) => due.push({ at: now + ms, act }) && due.at(-1);
  const mocked = [
    mock.method(performance, 'now', () => now),
    mock.method(globalThis, 'setTimeout', (act, ms) => later(ms, act)),
    mock.method(globalThis, 'clearTimeout', (timer) => timer && (timer.act = () => {})),
    mock.method(console, 'warn', () => {}),
  ];
  const started = [];
  const said = [];
  globalThis.Worker = class {
    constructor() {
      started.push(now);
      lives({ life: started.length - 1, later: (ms, data) => later(ms, () => this.ended || this.onmessage({ data })) });
    }
    postMessage() {}
    terminate() {
      this.ended = true;
    }
  };
  const link = new logic.StreamLink({ socket: '', token: null, budget: { gaussians: 100, megabits: 0 } });
  link.onMessage = (message) => said.push(message);
  try {
    link.start();
    while (due.length > 0) {
      due.sort((a, b) => a.at - b.at);
      if (due[0].at > untilMs) break;
      const next = due.shift();
      now = next.at;
      next.act();
    }
  } finally {
    for (const one of mocked) one.mock.restore();
    delete globalThis.Worker;
  }
  return { started, waits: said.filter(({ state }) => state === 'waiting') };
}
const kOpen = { kind: 'connection', state: 'open', retryS: 0 };
const kTooLarge = { kind: 'failed', reason: 'out of memory: the model does not fit' };

test('a model that does not fit is downloaded again more and more seldom, however long its download takes', () => {
  const { started, waits } = linked(({ later }) => {
    later(100, kOpen);
    later(20_000, kTooLarge);
  }, 600_000);
  assert.ok(waits.every(({ died }) => died === 'out of memory'));
  // 20 s each, and 5, 7.5, 11 ... s between, give or take a quarter: back at once they would be 29.
  assert.ok(started.length >= 8 && started.length <= 14, `${started.length} downloads in ten minutes`);
  assert.ok(waits.at(-1).retryS > 4 * waits[0].retryS, `${waits.map(({ retryS }) => retryS)}`);
});

test('one that was there as a whole is back soon', () => {
  const { waits } = linked(({ later }) => {
    later(100, kOpen);
    later(2000, { kind: 'figures', figures: { gaussians: 9, missing: 0 } });
    later(20_000, kTooLarge);
  }, 600_000);
  assert.ok(waits.length > 15 && waits.every(({ retryS }) => retryS <= 6.25), `${waits.map(({ retryS }) => retryS)}`);
});

test('so is one of a world beyond the budget, of which all was there that comes', () => {
  const { waits } = linked(({ later }) => {
    later(100, kOpen);
    for (let ms = 2000; ms < 20_000; ms += 250) later(ms, { kind: 'figures', figures: { gaussians: 9, missing: 90 } });
    later(20_000, kTooLarge);
  }, 600_000);
  assert.ok(waits.length > 15 && waits.every(({ retryS }) => retryS <= 6.25), `${waits.map(({ retryS }) => retryS)}`);
});

test('a worker that dies as soon as it is connected waits longer each time; one that has lived for a while is back at once', () => {
  const { waits } = linked(({ life, later }) => {
    later(50, kOpen);
    later(life < 12 ? 100 : 30_000, { kind: 'failed', reason: 'RuntimeError: unreachable' });
  }, 200_000);
  assert.ok(waits[11].retryS > 5, `${waits[11].retryS} s`);
  assert.ok(waits[12].retryS < 0.35, `${waits[12].retryS} s`);
  assert.ok(waits.every(({ died }) => died === 'by itself'));
});
