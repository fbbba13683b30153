// node replay.mjs MODULE FOLDER [MUTANTS [SEED]]: gives the logs that write_logs has made to splatbus.wasm. What is held
// is what the native build holds, after every message; what a GPU is given too, but for the last bit of a colour; and
// messages that were tampered with are refused or harmless.
import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';
import { join } from 'node:path';
import { instantiate } from '../../web/wasm/instantiate.mjs';

const [modulePath, folder, mutants = '100000', seed = '1'] = process.argv.slice(2);
const kRecordBytes = 32;
const kMost = 1 << 20;
const kMostMemory = 256 << 20;

const module = new WebAssembly.Module(readFileSync(modulePath));
const wasm = await instantiate(module);

/** As they come through a WebSocket: u32 length of the packet, packet, payload. */
function messagesOf(path) {
  const log = readFileSync(path);
  const messages = [];
  for (let at = 0; at < log.length; ) {
    const packet = log.readUInt32LE(at);
    const end = at + 8 + packet + log.readUInt32LE(at + 4);
    messages.push(Buffer.concat([log.subarray(at, at + 4), log.subarray(at + 8, end)]));
    at = end;
  }
  return messages;
}

class Viewer {
  #name = wasm.alloc(4);
  session = wasm.follower_new(this.#name, 4, 1 << 22, 0);
  receive(message) {
    const at = wasm.alloc(message.length);
    new Uint8Array(wasm.memory.buffer).set(message, at);
    const result = wasm.receive(this.session, at, message.length, 0);
    wasm.release(at);
    return result;
  }
  get error() {
    return Buffer.from(wasm.memory.buffer, wasm.error_text(this.session), wasm.error_bytes(this.session)).toString();
  }
  get hash() {
    const [low, high] = new Uint32Array(wasm.memory.buffer, wasm.held_hash_ptr(this.session), 2);
    return ((BigInt(high) << 32n) | BigInt(low)).toString(16).padStart(16, '0');
  }
  /** [n] rows, and what is in them: records or colours. */
  take(what, pointer, bytes) {
    const n = what(this.session, kMost);
    const rows = Uint32Array.from(new Uint32Array(wasm.memory.buffer, wasm.changed_rows_ptr(this.session), n));
    return [rows, Buffer.from(new Uint8Array(wasm.memory.buffer, pointer(this.session), n * bytes))];
  }
  end() {
    wasm.follower_delete(this.session);
    wasm.release(this.#name);
  }
}

function decoded(rgb9e5) {
  return [0, 9, 18].map((shift) => ((rgb9e5 >>> shift) & 511) * 2 ** ((rgb9e5 >>> 27) - 24));
}

function replayLong() {
  const messages = messagesOf(join(folder, 'long.log'));
  const hashes = readFileSync(join(folder, 'long.hashes'), 'utf8').trim().split('\n');
  assert.equal(messages.length, hashes.length);
  const viewer = new Viewer();
  messages.forEach((message, k) => {
    assert.equal(viewer.receive(message), 0, viewer.error);
    assert.equal(viewer.hash, hashes[k], `after message ${k}`);
  });
  assert.equal(new Set(hashes).size > messages.length / 2, true, 'the messages change something');
  viewer.end();
}

/** Taken after every message, as the native ones were: it decides objects' indices. */
function compareRows() {
  const messages = messagesOf(join(folder, 'long.log'));
  const expected = readFileSync(join(folder, 'long.rows'));
  const viewer = new Viewer();
  let memory = Buffer.alloc(0);
  const take = () => {
    const [rows, records] = viewer.take(wasm.take_changes, wasm.changed_records_ptr, kRecordBytes);
    const capacity = kRecordBytes * wasm.row_capacity(viewer.session);
    if (capacity > memory.length) memory = Buffer.concat([memory, Buffer.alloc(capacity - memory.length)]);
    rows.forEach((row, k) => records.copy(memory, kRecordBytes * row, kRecordBytes * k, kRecordBytes * (k + 1)));
    const [recolored, colors] = viewer.take(wasm.take_colors, wasm.changed_colors_ptr, 4);
    recolored.forEach((row, k) => memory.writeUInt32LE(colors.readUInt32LE(4 * k), kRecordBytes * row + 28));
  };
  for (const message of messages) {
    viewer.receive(message);
    take();
  }
  const stats = new Float64Array(wasm.memory.buffer, wasm.stats_ptr(viewer.session), 17);
  assert.ok(stats[16] > 0 && stats[16] === stats[13], 'colors are of the scene');
  assert.equal(memory.length, expected.length);
  let shown = 0;
  for (let at = 0; at < memory.length; at += kRecordBytes) {
    assert.equal(memory.compare(expected, at, at + 28, at, at + 28), 0, `row ${at / kRecordBytes}`);
    const [ours, theirs] = [memory, expected].map((rows) => decoded(rows.readUInt32LE(at + 28)));
    const step = Math.max(...theirs) / 255;
    ours.forEach((value, c) => assert.ok(Math.abs(value - theirs[c]) <= step, `row ${at / kRecordBytes}`));
    if (memory[at + 24] > 0) ++shown;
  }
  assert.ok(shown > 15000, `${shown} rows are shown`);
  viewer.end();
}

/** Marsaglia's xorshift. */
function randomOf(start) {
  let state = (Number(start) * 2654435761) >>> 0 || 1;
  return (below) => {
    state ^= state << 13;
    state ^= state >>> 17;
    state ^= state << 5;
    return (state >>> 0) % below;
  };
}

const kInteresting = [0, 1, 0x7fffffff, 0x80000000, 0xffffffff, 0xfffffff0, 0x00400001, 1 << 28];

function mutated(message, random) {
  let bytes = Buffer.from(message);
  for (let change = 1 + random(3); change > 0 && bytes.length > 0; --change) {
    const at = random(bytes.length);
    switch (random(6)) {
      case 0:
        bytes[at] = random(256);
        break;
      case 1:
        bytes[at] ^= 1 << random(8);
        break;
      case 2:
        bytes = bytes.subarray(0, at);
        break;
      case 3:
        bytes = Buffer.concat([bytes.subarray(0, at), Buffer.alloc(random(64), random(256)), bytes.subarray(at)]);
        break;
      case 4:
        if (at + 4 <= bytes.length) bytes.writeUInt32LE(kInteresting[random(kInteresting.length)], at);
        break;
      default: {
        const from = random(bytes.length);
        bytes.copy(bytes, at, from, from + random(32));
      }
    }
  }
  return bytes;
}

/** A mutant comes where the true message was due. One that changes what is held is the last. */
function tamper(log, wanted) {
  const messages = messagesOf(join(folder, log));
  const random = randomOf(seed);
  const results = [0, 0, 0];
  let fed = 0;
  let changed = 0;
  while (fed < wanted) {
    const viewer = new Viewer();
    const due = random(messages.length);
    for (let k = 0; k < due; ++k) assert.equal(viewer.receive(messages[k]), 0, viewer.error);
    const before = viewer.hash;
    for (let k = 0, usable = true; usable && k < 64 && fed < wanted; ++k, ++fed) {
      ++results[viewer.receive(mutated(messages[due], random))];
      const same = viewer.hash === before;
      if (!same) ++changed;
      usable = same;
    }
    viewer.take(wasm.take_changes, wasm.changed_records_ptr, kRecordBytes);
    viewer.take(wasm.take_colors, wasm.changed_colors_ptr, 4);
    wasm.next_outgoing(viewer.session, 10_000);
    viewer.end();
    if (wasm.memory.buffer.byteLength > kMostMemory) assert.fail(`${wasm.memory.buffer.byteLength} bytes of memory`);
  }
  assert.equal(results[2], 0, 'ran out of memory');
  assert.ok(results[1] > fed / 2, `${results[1]} of ${fed} refused`);
  console.log(`seed ${seed}, ${log}: ${fed} mutants, ${results[1]} refused, ${changed} changed what is held`);
}

/** What a page wishes is in the next thing that it says of what it holds, and in what it greets with. */
function wishes() {
  const has = (viewer, nowMs, value) => {
    const bytes = wasm.next_outgoing(viewer.session, nowMs);
    const said = Buffer.from(new Uint8Array(wasm.memory.buffer, wasm.outgoing_ptr(viewer.session), bytes));
    const wanted = Buffer.alloc(4);
    wanted.writeUInt32LE(value);
    return bytes > 0 && said.includes(wanted);
  };
  const viewer = new Viewer();
  wasm.set_max_kbps(viewer.session, 7_654_321);
  assert.ok(has(viewer, 1000, 7_654_321), 'the greeting');
  viewer.receive(messagesOf(join(folder, 'long.log'))[0]); // the welcome
  wasm.set_max_kbps(viewer.session, 1_234_567);
  let heard = false;
  for (let nowMs = 1000; nowMs < 3000 && !heard; nowMs += 50) heard = has(viewer, nowMs, 1_234_567);
  assert.ok(heard, 'while it follows');
  viewer.end();
}

replayLong();
compareRows();
wishes();
tamper('short.log', Number(mutants));
tamper('radiance.log', Number(mutants) / 20); // its pages are sixty times as large
