// What the stream's worker hands on, and when, with clocks that the tests make.
import assert from 'node:assert/strict';
import { resolve } from 'node:path';
import { test } from 'node:test';
import { pathToFileURL } from 'node:url';

const kPages = process.env.SPLATBUS_WEB_TESTS ?? '../build/release/web-tests';
const logic = await import(pathToFileURL(resolve(kPages, 'logic.js')));

const record = (opacity, color = 7) => [0, 0, 0, 0, 0, 0, opacity, color];
const { kNoRow } = logic;
const turnoverOf = (origins, left) => ({ origins: new Uint32Array(origins), left: new Uint8Array(left) });
/** `origins` and `left` of each row: all have arrived, and whoever was there has left. */
const update = (mirror, rows, nowS, origins = Object.keys(rows).map(() => kNoRow), left = origins.map(() => 1)) =>
  mirror.take({ rows: new Uint32Array(Object.keys(rows).map(Number)), records: new Uint32Array(Object.values(rows).flat()), turnover: turnoverOf(origins, left) }, nowS);

test('rows that appear and vanish fade, those that change do not', () => {
  const mirror = new logic.RowMirror();
  assert.deepEqual([...update(mirror, { 3: record(200) }, 10).fades], [10]);
  assert.deepEqual([...update(mirror, { 3: record(100), 5: record(50) }, 11, [3, kNoRow], [0, 1]).fades], [10, 11]);
  const gone = update(mirror, { 3: record(0) }, 12);
  assert.deepEqual([...gone.fades], [-12]);
  assert.deepEqual([...gone.records], record(100), 'it is still to be seen');
  assert.equal(mirror.takeVanished(12.1), null);
  const free = mirror.takeVanished(12.5);
  assert.deepEqual([...free.rows], [3]);
  assert.equal(free.records[6], 0);
  assert.deepEqual([...mirror.everything().rows], [5]);
});

test('harmonics fade with their rows, and are there for who begins anew', () => {
  const mirror = new logic.RowMirror();
  const radiant = (row, opacity, value, nowS) => {
    const harmonics = { words: 4, values: new Uint32Array(4).fill(value) };
    return mirror.take({ rows: new Uint32Array([row]), records: new Uint32Array(record(opacity)), turnover: turnoverOf([kNoRow], [1]), harmonics }, nowS);
  };
  radiant(3, 200, 11, 10);
  radiant(5, 200, 12, 10);
  assert.deepEqual([...radiant(3, 0, 0, 12).harmonics.values], [11, 11, 11, 11], 'they are still to be seen');
  assert.deepEqual([...mirror.everything().harmonics.values], [11, 11, 11, 11, 12, 12, 12, 12]);
  // Without harmonics a renderer would take it for a model that has none.
  assert.equal(mirror.takeVanished(12.5).harmonics.words, 4);
  assert.deepEqual([...mirror.everything().harmonics.values], [12, 12, 12, 12]);
  // Another model, whose colors do not depend on the view.
  update(mirror, { 5: record(200) }, 13);
  assert.equal(mirror.everything().harmonics, undefined);
});

/** Somewhere else than what record() makes, too far for the one to stand for the other. */
const elsewhere = (opacity, color = 7) => [...new Uint32Array(new Float32Array([5, 0, 0]).buffer), 0, 0, 0, opacity, color];
/** What a picture shows of rows, as {row: [opacity, fade]}. */
const seen = ({ rows, records, fades }) => Object.fromEntries([...rows].map((row, k) => [row, [records[8 * k + 6], Math.fround(fades[k])]]));

test('a row that is given away while it fades stays, and what was in it fades on in another', () => {
  const mirror = new logic.RowMirror();
  update(mirror, { 2: record(10), 3: record(200) }, 10);
  update(mirror, { 2: record(0), 3: record(0) }, 11);
  mirror.takeVanished(11.5);
  update(mirror, { 3: record(200) }, 12);
  update(mirror, { 3: record(0) }, 13);
  assert.deepEqual(seen(update(mirror, { 3: elsewhere(90) }, 13.1)), { 4: [200, -13], 3: [90, Math.fround(13.1)] });
  assert.deepEqual([...mirror.takeVanished(14).rows], [4]);
  assert.deepEqual([...mirror.everything().records], elsewhere(90));
  assert.equal(mirror.count, 1);
});

test('who takes the row of another lets it vanish in a free one', () => {
  const mirror = new logic.RowMirror();
  update(mirror, { 0: record(10), 1: record(20), 2: record(30) }, 10);
  // A page's last Gaussian fills the gap of one that is gone, and the row behind is free.
  const moved = update(mirror, { 1: elsewhere(30), 2: record(0) }, 11, [2, kNoRow], [1, 0]);
  assert.deepEqual(seen(moved), { 1: [30, 10], 2: [20, -11] });
  assert.deepEqual([...moved.rows], [1, 2], 'each once');
  assert.equal(mirror.count, 2);
  assert.deepEqual([...mirror.takeVanished(11.3).rows], [2]);
  // Where no row is free, in one behind all others, which the model may come to have itself.
  update(mirror, { 2: record(40) }, 12);
  assert.deepEqual(seen(update(mirror, { 2: elsewhere(50) }, 13)), { 2: [50, 13], 3: [40, -13] });
  assert.deepEqual(seen(update(mirror, { 3: elsewhere(60) }, 13.1)), { 3: [60, Math.fround(13.1)], 4: [40, -13] });
  assert.deepEqual([...mirror.takeVanished(13.5).rows], [4]);
  assert.equal(mirror.takeVanished(14), null);
});

test('rows of what vanishes are used again, and never by two', () => {
  const mirror = new logic.RowMirror();
  const rows = (opacity, at = 0) => Object.fromEntries(Array.from({ length: 100 }, (_, row) => [row, [...new Uint32Array(new Float32Array([5 * at, 0, 0]).buffer), 0, 0, 0, opacity, 7]]));
  update(mirror, rows(1), 10);
  for (let turn = 1; turn < 20; ++turn) {
    const sent = update(mirror, rows(1 + turn, turn), 10 + 0.1 * turn);
    assert.equal(new Set(sent.rows).size, sent.rows.length);
    mirror.takeVanished(10 + 0.1 * turn + 0.05);
    const all = mirror.everything();
    for (const opacity of [1 + turn, turn]) assert.equal(all.records.filter((value, at) => at % 8 === 6 && value === opacity).length, 100, `${opacity} of turn ${turn}`);
    assert.ok(Math.max(...all.rows) < 500);
    assert.equal(mirror.count, 100);
  }
});

test('who moves into the row of one that it resembles does not stand for it', () => {
  const mirror = new logic.RowMirror();
  update(mirror, { 0: record(100), 1: record(20) }, 10);
  assert.deepEqual(seen(update(mirror, { 0: record(20), 1: record(0) }, 11, [1, kNoRow], [1, 0])), { 0: [20, 10], 1: [100, -11] });
  // Who begins to appear is replaced by one that stands for it, which goes on to appear; who can no longer be seen fades.
  update(mirror, { 0: record(30) }, 12.1);
  assert.deepEqual(seen(update(mirror, { 0: record(0) }, 13, [0], [0])), { 0: [30, -13] });
});

test('who moves neither fades nor vanishes, and who stands for another does not either', () => {
  const mirror = new logic.RowMirror();
  update(mirror, { 0: record(10), 1: record(20), 2: record(0) }, 10);
  assert.deepEqual(seen(update(mirror, { 1: record(0), 2: record(20) }, 10.1, [kNoRow, 1], [0, 0])), { 1: [0, 0], 2: [20, 10] }, 'it goes on to appear');
  assert.equal(mirror.takeVanished(12), null);
  assert.deepEqual(seen(update(mirror, { 0: record(15) }, 13)), { 0: [15, 10] });
  assert.equal(mirror.takeVanished(14), null);
});

test('harmonics go with what is displaced', () => {
  const mirror = new logic.RowMirror();
  const take = (rows, records, values, nowS) =>
    mirror.take({ rows: new Uint32Array(rows), records: new Uint32Array(records.flat()), turnover: turnoverOf(rows.map(() => kNoRow), rows.map(() => 1)), harmonics: { words: 4, values: new Uint32Array(values.flatMap((value) => [value, value, value, value])) } }, nowS);
  take([0, 1, 5], [record(10), record(20), record(30)], [1, 2, 3], 10);
  const { rows, harmonics } = take([0], [elsewhere(40)], [4], 11);
  assert.equal(rows.length, 2);
  assert.deepEqual([...harmonics.values], [4, 4, 4, 4, 1, 1, 1, 1]);
  const all = mirror.everything();
  const first = (row) => all.harmonics.values[4 * all.rows.indexOf(row)];
  assert.deepEqual([0, 1, 5, rows[1]].map(first), [4, 2, 3, 1]);
});

test('a row that has vanished becomes free however long the page is open', () => {
  for (let nowS = 10 * 3600; nowS < 10 * 3600 + 1; nowS += 0.0107) {
    const mirror = new logic.RowMirror();
    update(mirror, { 3: record(200) }, nowS - 10);
    update(mirror, { 3: record(0) }, nowS);
    assert.deepEqual([...(mirror.takeVanished(nowS + 0.3)?.rows ?? [])], [3], `${nowS} s`);
  }
});

/** A publisher of rows, and what it has sent. */
function publishing({ budget = 1e6 } = {}) {
  const clock = { s: 1 };
  const publisher = new logic.Publisher(() => clock.s, budget);
  const sent = [];
  const port = { postMessage: (batch) => sent.push(batch), close() {} };
  const scene = { transforms: new Float32Array(12), farField: 0, player: 0, background: [0, 0, 0], displaySpace: false };
  const nothing = { rows: new Uint32Array(0), colors: new Uint32Array(0) };
  const publish = (row, complete, opacity = 9) =>
    publisher.publish({ rows: new Uint32Array([row]), records: new Uint32Array(record(opacity)), turnover: turnoverOf([kNoRow], [1]) }, nothing, scene, { captureMs: 0, arrivedMs: 0 }, complete);
  return { clock, publisher, sent, port, publish };
}

test('what vanishes goes on to, where a picture that stands is replaced', () => {
  const { publisher, sent, port, publish } = publishing();
  publisher.attach(port, 100);
  publish(0, false);
  publish(1, false);
  publish(0, true, 0);
  assert.deepEqual(seen(sent[0].update), { 0: [9, -1], 1: [9, 0] });
});

test('a picture that stands is replaced by a whole model, and by no part of one', () => {
  const { publisher, sent, port, publish } = publishing();
  publisher.attach(port, 100);
  publish(0, false);
  assert.equal(sent.length, 0);
  publish(1, true);
  assert.deepEqual(sent.map(({ whole, update }) => [whole, ...update.rows]), [[true, 0, 1]]);
  assert.deepEqual([...sent[0].update.fades], [0, 0], 'and does not fade in');
  publish(2, true);
  assert.ok(!publisher.ready, 'two are under way');
  publisher.taken();
  assert.ok(publisher.ready);
});

test('where the rest never comes a picture that stands is replaced by as much as there is room for', () => {
  const { publisher, sent, port, publish } = publishing({ budget: 20 });
  publisher.attach(port, 100);
  for (let row = 0; row < 17; ++row) publish(row, false);
  publish(3, false, 0); // it vanishes, and counts no more
  publish(17, false);
  publisher.tidy();
  assert.equal(sent.length, 0, 'seventeen are not enough');
  publish(18, false);
  assert.deepEqual(sent.map(({ whole, shown }) => [whole, shown]), [[true, 18]]);
  publisher.attach(port, 18); // another device
  assert.deepEqual(sent.map(({ whole, shown }) => [whole, shown]), [[true, 18], [true, 18]], 'at once');
  publisher.attach(port, 0);
  assert.equal(sent.length, 3, 'where no picture stands too');
});

test('a picture that stands is replaced by as much as it has, and some seconds later by anything', () => {
  const full = publishing();
  full.publisher.attach(full.port, 10);
  for (let row = 0; row < 8; ++row) full.publish(row, false);
  assert.equal(full.sent.length, 0);
  full.publish(8, false);
  assert.equal(full.sent.length, 1);
  const { clock, publisher, sent, port, publish } = publishing();
  publisher.attach(port, 10);
  clock.s = 100;
  publisher.tidy();
  publish(0, false);
  assert.equal(sent.length, 0, 'seconds without anything do not count');
  clock.s = 104.9;
  publisher.tidy();
  assert.equal(sent.length, 0);
  clock.s = 105;
  publisher.tidy();
  assert.deepEqual(sent.map(({ whole, shown }) => [whole, shown]), [[true, 1]], 'without any more news');
});

test('figures are said four times a second, and at once of a model that has become whole or is another', () => {
  const due = new logic.FiguresDue();
  const at = (atMs, { gaussians = 9, missing = 0, epoch = 1 } = {}) => due.take({ atMs, gaussians, missing, epoch });
  assert.ok(at(0, { gaussians: 0, missing: -1 }));
  assert.ok(!at(10, { missing: 3 }));
  assert.ok(!at(20, { gaussians: 0 }), 'nothing is no model');
  assert.ok(at(30));
  assert.ok(!at(40, { missing: 1 }));
  assert.ok(!at(50), 'it has been said');
  assert.ok(!at(279));
  assert.ok(at(280, { missing: 1 }));
  assert.ok(at(290, { epoch: 2, missing: -1 }));
  assert.ok(at(300, { epoch: 2 }));
  due.hurry();
  assert.ok(at(310, { epoch: 2 }));
  assert.ok(!at(320, { epoch: 2 }));
});
