// What the stream's worker hands on, and when, with clocks that the tests make.
import assert from 'node:assert/strict';
import { resolve } from 'node:path';
import { test } from 'node:test';
import { pathToFileURL } from 'node:url';

const kPages = process.env.SPLATBUS_WEB_TESTS ?? '../build/release/web-tests';
const logic = await import(pathToFileURL(resolve(kPages, 'logic.js')));

const record = (opacity, color = 7) => [0, 0, 0, 0, 0, 0, opacity, color];
const update = (mirror, rows, nowS) =>
  mirror.take({ rows: new Uint32Array(Object.keys(rows).map(Number)), records: new Uint32Array(Object.values(rows).flat()) }, nowS);

test('rows that appear and vanish fade, those that change do not', () => {
  const mirror = new logic.RowMirror();
  assert.deepEqual([...update(mirror, { 3: record(200) }, 10).fades], [10]);
  assert.deepEqual([...update(mirror, { 3: record(100), 5: record(50) }, 11).fades], [10, 11]);
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
    return mirror.take({ rows: new Uint32Array([row]), records: new Uint32Array(record(opacity)), harmonics }, nowS);
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

test('a row that is given away while it fades stays', () => {
  const mirror = new logic.RowMirror();
  update(mirror, { 3: record(200) }, 10);
  update(mirror, { 3: record(0) }, 11);
  assert.deepEqual([...update(mirror, { 3: record(90) }, 11.1).fades], [Math.fround(11.1)]);
  assert.equal(mirror.takeVanished(12), null);
  assert.deepEqual([...mirror.everything().records], record(90));
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
    publisher.publish({ rows: new Uint32Array([row]), records: new Uint32Array(record(opacity)) }, nothing, scene, { captureMs: 0, arrivedMs: 0 }, complete);
  return { clock, publisher, sent, port, publish };
}

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
