// A recording, as @mcap/core reads it: its indexes and checksums, and every message by the schema that lies in the file,
// against the golden files.
import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { mkdtempSync, readFileSync, rmSync } from 'node:fs';
import { open } from 'node:fs/promises';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { after, before, test } from 'node:test';
import { McapIndexedReader, McapStreamReader } from '@mcap/core';
import { ByteBuffer } from 'flatbuffers';
import flatbuffersReflection from 'flatbuffers_reflection';
import { decompress } from 'fzstd';

const { SPLATBUS_WRITE_RECORDING: program, SPLATBUS_GOLDEN: golden } = process.env;
const { Parser, Schema, Table } = flatbuffersReflection;
const kTables = ['SceneUpdate', 'CaptureReference', 'ModelPublished', 'Heartbeat', 'EngineFrame'];
const decompressHandlers = { zstd: (bytes, size) => decompress(bytes, new Uint8Array(Number(size))) };
let folder;
let path;

before(() => {
  folder = mkdtempSync(join(tmpdir(), 'splatbus-recording-'));
  path = join(folder, 'golden.mcap');
  execFileSync(program, [path, golden]);
});
after(() => rmSync(folder, { recursive: true, force: true }));

/** As the golden JSON has it: numbers that are exact, names of enum values, bytes as numbers. */
function plain(value) {
  if (typeof value === 'bigint') return Number(value);
  if (ArrayBuffer.isView(value)) return [...value].map(plain);
  if (Array.isArray(value)) return value.map(plain);
  if (value === null || typeof value !== 'object') return value;
  return Object.fromEntries(Object.entries(value).map(([key, entry]) => [key, plain(entry)]));
}

/** Every scalar and text of the golden message in its place; enums are numbers here and names there. */
function compare(read, truth, where) {
  if (typeof truth === 'string' && typeof read === 'number') return;
  if (Array.isArray(truth)) assert.equal(read.length, truth.length, where);
  if (truth !== null && typeof truth === 'object') {
    for (const key of Object.keys(truth)) compare(read[key], truth[key], `${where}.${key}`);
  } else if (typeof truth === 'number' && !Number.isInteger(truth)) {
    assert.ok(Math.abs(read - truth) <= 1e-5 * Math.abs(truth), `${where}: ${read} instead of ${truth}`);
  } else {
    assert.equal(read, truth, where);
  }
}

async function openIndexed() {
  const handle = await open(path);
  const readable = {
    size: async () => BigInt((await handle.stat()).size),
    read: async (offset, size) => {
      const bytes = new Uint8Array(Number(size));
      const { bytesRead } = await handle.read(bytes, 0, bytes.length, Number(offset));
      assert.equal(bytesRead, bytes.length);
      return bytes;
    },
  };
  return { handle, reader: await McapIndexedReader.Initialize({ readable, decompressHandlers }) };
}

test('its indexes name every message, and its schemas read it', async () => {
  const { handle, reader } = await openIndexed();
  assert.equal(reader.header.profile, 'splatbus');
  assert.equal(reader.statistics.messageCount, 5n);
  assert.equal(reader.statistics.channelCount, 5);
  assert.equal(reader.statistics.messageStartTime, 1700000000000000001n);
  assert.ok(reader.chunkIndexes.length >= 1);
  assert.ok(reader.chunkIndexes.every((chunk) => chunk.compression === 'zstd'));
  const seen = [];
  for await (const message of reader.readMessages()) {
    const channel = reader.channelsById.get(message.channelId);
    const schema = reader.schemasById.get(channel.schemaId);
    const name = channel.topic.slice('golden/'.length);
    assert.equal(channel.messageEncoding, 'flatbuffer');
    assert.equal(schema.encoding, 'flatbuffer');
    assert.equal(schema.name, `splatbus.wire.${name}`);
    assert.match(channel.metadata.get('schema'), new RegExp(`^${name}/[0-9]+$`));
    assert.equal(channel.metadata.get('latched'), String(seen.length % 2 === 0));
    assert.equal(message.publishTime, 1600000000000000001n + BigInt(seen.length));
    assert.equal(message.sequence, seen.length + 1);
    const types = Schema.getRootAsSchema(new ByteBuffer(schema.data));
    const table = Table.getNamedTable(new ByteBuffer(message.data), types, schema.name);
    const read = plain(new Parser(types).toObject(table, true));
    compare(read, JSON.parse(readFileSync(join(golden, `${name}.json`), 'utf8')), name);
    seen.push(name);
  }
  assert.deepEqual(seen, kTables);
  const drops = [];
  for await (const metadata of reader.readMetadata({ name: 'splatbus.drops' })) drops.push(...metadata.metadata);
  assert.deepEqual(drops, [['golden/Heartbeat', '3 (slow disk 3)']]);
  await handle.close();
});

test('read from its start, its checksums are right', () => {
  const reader = new McapStreamReader({ validateCrcs: true, includeChunks: true, decompressHandlers });
  reader.append(readFileSync(path));
  const kinds = [];
  for (let record; (record = reader.nextRecord()); ) kinds.push(record.type);
  assert.ok(reader.done());
  assert.equal(kinds.filter((kind) => kind === 'Message').length, 5);
  assert.equal(kinds.at(-1), 'Footer');
});

test('a checksum that is wrong is noticed', () => {
  const bytes = readFileSync(path);
  const reader = new McapStreamReader({ validateCrcs: true, includeChunks: true, decompressHandlers });
  const at = bytes.indexOf('zstd');
  bytes[at - 5] ^= 1; // of the chunk's checksum, which lies before the name's length
  reader.append(bytes);
  assert.throws(() => {
    while (reader.nextRecord());
  }, /CRC/i);
});
