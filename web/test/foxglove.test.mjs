// The gateway as Foxglove's own client sees it, before a bus whose scene tests/foxglove/foxglove_source.cpp makes up.
import assert from 'node:assert/strict';
import { spawn } from 'node:child_process';
import { mkdtempSync, rmSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { after, before, test } from 'node:test';
import { setTimeout } from 'node:timers/promises';
import foxglove from '@foxglove/schemas/internal.js';
import protocol from '@foxglove/ws-protocol';
import { ByteBuffer } from 'flatbuffers';
import reflection from 'flatbuffers_reflection';
import WebSocket from 'ws';
import { freePort, until } from './pipeline.mjs';

const { FoxgloveClient } = protocol;
const kPatienceMs = 90_000;
const folder = mkdtempSync(join(tmpdir(), 'splatbus-foxglove-'));
const processes = [];
const firstAnswers = [];
let url;
let client;

/** A client that keeps what it has been told; its channels by topic. */
async function connect(subprotocol) {
  const socket = new WebSocket(`${url.replace('http', 'ws')}/foxglove`, [subprotocol]);
  const foxglove = new FoxgloveClient({ ws: socket });
  const kept = { foxglove, socket, channels: new Map(), subscriptions: new Map(), statuses: [], values: [], times: [], graphs: [], assets: [] };
  foxglove.on('serverInfo', (info) => (kept.info = info));
  foxglove.on('advertise', (added) => added.forEach((channel) => kept.channels.set(channel.topic, channel)));
  foxglove.on('message', ({ subscriptionId, data, timestamp }) => kept.subscriptions.get(subscriptionId)?.push({ data, timestamp }));
  foxglove.on('status', (status) => kept.statuses.push(status));
  foxglove.on('parameterValues', (values) => kept.values.push(values));
  foxglove.on('time', (time) => kept.times.push(time.timestamp));
  foxglove.on('connectionGraphUpdate', (graph) => kept.graphs.push(graph));
  foxglove.on('fetchAssetResponse', (asset) => kept.assets.push(asset));
  foxglove.on('error', (error) => (kept.error = error));
  await new Promise((resolve, reject) => {
    foxglove.on('open', resolve);
    socket.on('unexpected-response', (_, response) => reject(new Error(`HTTP ${response.statusCode}`)));
  });
  return kept;
}

/** As Foxglove itself decodes a channel's messages: by nothing but the schema that came with it. */
function decoder({ schema, schemaName }) {
  const rootSchema = reflection.Schema.getRootAsSchema(new ByteBuffer(Buffer.from(schema, 'base64')));
  const typeIndex = rootSchema.unpack().objects.findIndex(({ name }) => name === schemaName);
  assert.notEqual(typeIndex, -1, schemaName);
  const toObject = new reflection.Parser(rootSchema).toObjectLambda(typeIndex, true);
  return (data) => {
    // At an address of its own: scalars are read where they are aligned.
    const buffer = new ByteBuffer(new Uint8Array(data.buffer.slice(data.byteOffset, data.byteOffset + data.byteLength)));
    return toObject(new reflection.Table(buffer, typeIndex, buffer.readInt32(buffer.position()) + buffer.position(), false));
  };
}

/** Decoded messages of a topic, once `enough` holds for those that have come. */
async function messagesOf(topic, enough = (messages) => messages.length > 0) {
  await until(() => client.channels.has(topic));
  const channel = client.channels.get(topic);
  const decode = decoder(channel);
  const raw = [];
  const id = client.foxglove.subscribe(channel.id);
  client.subscriptions.set(id, raw);
  let decoded = [];
  await until(() => {
    decoded = raw.map(({ data, timestamp }) => ({ ...decode(data), timestamp_ns: timestamp }));
    return enough(decoded);
  });
  client.foxglove.unsubscribe(id);
  return decoded;
}

const near = (actual, expected, tolerance = 1e-5) =>
  assert.ok(actual.every((value, i) => Math.abs(value - expected[i]) <= tolerance), `${actual} is not ${expected}`);
const cross = ([a, b, c], [x, y, z]) => [b * z - c * y, c * x - a * z, a * y - b * x];

/** p_parent = rotation * p_child + translation, as FrameTransform's documentation has it. */
function toParent({ rotation: q, translation: t }, p) {
  const v = [q.x, q.y, q.z];
  const twice = cross(v, p).map((x) => 2 * x);
  const turned = cross(v, twice);
  return p.map((x, i) => x + q.w * twice[i] + turned[i] + [t.x, t.y, t.z][i]);
}

before(async () => {
  const { SPLATBUS_BIN: bin } = process.env;
  url = `http://127.0.0.1:${await freePort()}`;
  const start = (program, ...args) =>
    processes.push(spawn(join(bin, program), ['--bus', `ipc://${folder}/bus`, ...args], { stdio: 'ignore' }));
  start('splatbus-bus');
  start('foxglove_source');
  start('splatbus-gateway', '--set', `http=${new URL(url).host}`, '--set', 'web_root=/nonexistent', '--set', 'foxglove_points=500');
  // What the page is told of services is read apart from what Foxglove's clients are told, of which nothing is before one comes.
  await until(() => fetch(`${url}/status`).then((answer) => answer.json()).then(({ services }) => services.some(({ source, alive }) => source === 'source' && alive), () => false));
  // Each finds a gateway that knows of nothing: whether it has heard anything before the question comes is a matter of milliseconds.
  for (let visit = 0; visit < 8; ++visit) {
    const visitor = await connect('foxglove.websocket.v1');
    visitor.foxglove.getParameters([], 'at once');
    await until(() => visitor.values.length > 0);
    firstAnswers.push(visitor.values[0].parameters);
    visitor.socket.terminate();
    await until(() => fetch(`${url}/status`).then((answer) => answer.json()).then(({ gateway }) => gateway.foxglove.clients === 0));
    await setTimeout(200);
  }
  client = await connect('foxglove.websocket.v1');
}, { timeout: kPatienceMs });
after(async () => {
  client?.socket.terminate();
  for (const one of processes) {
    const ended = new Promise((resolve) => one.once('exit', resolve));
    one.kill('SIGKILL');
    await ended;
  }
  rmSync(folder, { recursive: true, force: true });
});

const live = (name, run) => test(name, { timeout: kPatienceMs }, run);

live('what there is, is listed, under both subprotocols', async () => {
  const expected = ['scene/state', 'sys/heartbeat', 'engine/cameras', 'capture/reference', 'foxglove/transforms', 'foxglove/points', 'foxglove/log', 'foxglove/cameras/reference-2/picture', 'foxglove/cameras/reference-2/depth', 'foxglove/cameras/reference-2/calibration'];
  const newer = await connect('foxglove.sdk.v1');
  for (const one of [client, newer]) {
    await until(() => expected.every((topic) => one.channels.has(topic)));
    assert.ok(one.info.capabilities.includes('parameters'));
    assert.equal(one.error, undefined);
  }
  assert.equal(newer.socket.protocol, 'foxglove.sdk.v1');
  for (const channel of client.channels.values()) decoder(channel);
  newer.socket.terminate();
});

live('a message of the bus decodes by its schema', async () => {
  const [state] = await messagesOf('scene/state');
  assert.equal(state.header.source, 'source');
  assert.equal(state.header.schema, 'SceneUpdate/1');
  assert.equal(state.scene.objects[0].id, 7);
  const { translation } = state.scene.objects[0].world_from_object;
  near([translation.x, translation.y, translation.z], [5, 6, 7]);
  assert.ok(Math.abs(Number(state.timestamp_ns) / 1e6 - Date.now()) < 600_000, 'the time is of day');
  const again = await messagesOf('scene/state');
  assert.equal(again.length, 1, 'a latched one comes to who subscribes later, too');
});

live('frames are where they have to be, and right-handed', async () => {
  const find = (messages, child) => messages.flatMap(({ transforms }) => transforms).find(({ child_frame_id }) => child_frame_id === child);
  const wanted = ['world', 'object/7', 'camera/reference-2', 'viewer/page'];
  const messages = await messagesOf('foxglove/transforms', (all) => wanted.every((child) => find(all, child)));
  const axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
  for (const child of wanted) {
    const frame = find(messages, child);
    assert.equal(frame.parent_frame_id, child === 'world' ? 'map' : 'world');
    const origin = toParent(frame, [0, 0, 0]);
    const [x, y, z] = axes.map((axis) => toParent(frame, axis).map((value, i) => value - origin[i]));
    near(cross(x, y), z);
  }
  near(toParent(find(messages, 'world'), [0, 1, 0]), [0, 0, 1]);
  near(toParent(find(messages, 'object/7'), [1, 0, 0]), [5 + Math.cos(0.5), 6, 7 - Math.sin(0.5)]);
  const camera = find(messages, 'camera/reference-2');
  near(toParent(camera, [0, 0, 0]), [1, 2, 3]);
  near(toParent(camera, [0, 0, Math.hypot(1, 2, 3)]), [0, 0, 0], 1e-4);
  assert.ok(toParent(camera, [0, 1, 0])[1] < 2, 'y is down');
});

live('a picture goes with its calibration', async () => {
  const [calibration] = await messagesOf('foxglove/cameras/reference-2/calibration');
  const [picture] = await messagesOf('foxglove/cameras/reference-2/picture');
  assert.equal(picture.frame_id, 'camera/reference-2');
  assert.equal(picture.frame_id, calibration.frame_id);
  const focal = 24 / Math.tan(0.5);
  near([...calibration.k], [focal, 0, 31.5, 0, focal, 23.5, 0, 0, 1], 1e-3);
  const jpeg = Buffer.from(picture.data);
  assert.equal(picture.format, 'jpeg');
  assert.equal(jpeg.readUInt16BE(0), 0xffd8);
  const frame = jpeg.indexOf(Buffer.from([0xff, 0xc0]));
  assert.deepEqual([jpeg.readUInt16BE(frame + 7), jpeg.readUInt16BE(frame + 5)], [calibration.width, calibration.height]);
});

live('depth is a picture of metres', async () => {
  const [depth] = await messagesOf('foxglove/cameras/reference-2/depth');
  assert.deepEqual([depth.width, depth.height, depth.encoding, depth.step], [64, 48, '32FC1', 256]);
  assert.equal(depth.frame_id, 'camera/reference-2');
  const bytes = Buffer.from(depth.data);
  assert.equal(bytes.length, 64 * 48 * 4);
  for (const [x, y, metres] of [[0, 0, 2], [31, 47, 2], [32, 3, 0.75], [63, 47, 11.75]]) assert.equal(bytes.readFloatLE(4 * (64 * y + x)), metres);
});

/** Holds a schema that the gateway sends against Foxglove's package for JavaScript: names, order and types of its fields. */
function compareSchemas(name, { objects, enums }) {
  const { BaseType } = reflection;
  const primitives = { uint32: BaseType.UInt, float64: BaseType.Double, string: BaseType.String, bytes: BaseType.Vector };
  const tables = { Timestamp: 'Time' };
  const nameOf = (message) => `foxglove.${tables[message] ?? message}`;
  const theirs = foxglove.foxgloveMessageSchemas[name].fields;
  const ours = objects.find((object) => object.name === nameOf(name)).fields.sort((one, other) => one.id - other.id);
  assert.deepEqual(ours.map((field) => field.name), theirs.map((field) => field.name.toLowerCase()), name);
  theirs.forEach(({ type, array }, i) => {
    const where = `${name}.${theirs[i].name}`;
    const { baseType, element, index } = ours[i].type;
    const isVector = array !== undefined && baseType === BaseType.Vector;
    const one = isVector ? element : baseType;
    assert.equal(isVector, array !== undefined, where);
    if (type.type === 'primitive') assert.equal(one, primitives[type.name], where);
    if (type.name === 'bytes') assert.equal(element, BaseType.UByte, where);
    if (type.type === 'enum') assert.deepEqual(enums[index].values.map((value) => [value.name, Number(value.value)]), type.enum.values.map((value) => [value.name, value.value]), where);
    if (type.type !== 'nested') return;
    assert.equal(one, BaseType.Obj, where);
    assert.equal(objects[index].name, nameOf(type.schema.name), where);
    if (type.schema.name !== 'Timestamp') compareSchemas(type.schema.name, { objects, enums });
  });
}

live('every schema of Foxglove is what Foxglove says that it is', async () => {
  const topics = ['foxglove/transforms', 'foxglove/points', 'foxglove/log', 'foxglove/cameras/reference-2/picture', 'foxglove/cameras/reference-2/depth', 'foxglove/cameras/reference-2/calibration'];
  await until(() => topics.every((topic) => client.channels.has(topic)));
  for (const topic of topics) {
    const { schema, schemaName } = client.channels.get(topic);
    compareSchemas(schemaName.replace('foxglove.', ''), reflection.Schema.getRootAsSchema(new ByteBuffer(Buffer.from(schema, 'base64'))).unpack());
  }
});

live('the cloud has as many of the model\'s Gaussians as are allowed, where they are', async () => {
  const [cloud] = await messagesOf('foxglove/points');
  assert.deepEqual(cloud.fields.map(({ name, offset, type }) => [name, offset, type]), [['x', 0, 7], ['y', 4, 7], ['z', 8, 7], ['red', 12, 1], ['green', 13, 1], ['blue', 14, 1], ['alpha', 15, 1]]);
  assert.equal(cloud.point_stride, 16);
  const bytes = Buffer.from(cloud.data);
  const count = bytes.length / 16;
  assert.ok(Number.isInteger(count) && count > 250 && count <= 500, `${count} points`);
  let moved = 0;
  for (let i = 0; i < count; ++i) {
    const y = bytes.readFloatLE(16 * i + 4);
    if (y > 5) ++moved;
    assert.ok(Math.abs(y) < 0.2 || Math.abs(y - 6) < 0.2, 'on the floor, or on object 7');
    assert.ok(bytes[16 * i + 15] > 60, 'nearly all are opaque');
  }
  assert.ok(moved > count / 6 && moved < count / 2, `${moved} of ${count} are of object 7`);
});

live('who asks once, and at once, gets all parameters, as Foxglove does', () => {
  for (const parameters of firstAnswers) {
    for (const wanted of ['source/rate', 'source/shown', 'source/label']) assert.ok(parameters.some(({ name }) => name === wanted), wanted);
  }
  assert.equal(firstAnswers.length, 8);
});

live('a parameter that is set is seen, and one out of range refused with the range', async () => {
  const answer = async (id) => {
    await until(() => client.values.some((one) => one.id === id));
    return client.values.find((one) => one.id === id).parameters;
  };
  client.foxglove.getParameters(['source/rate', 'source/shown', 'source/label'], 'three');
  assert.deepEqual(await answer('three'), [{ name: 'source/rate', value: 0.25, type: 'float64' }, { name: 'source/shown', value: true }, { name: 'source/label', value: '7' }]);
  const subscriptions = client.subscriptions.size;
  const log = messagesOf('foxglove/log', (lines) => lines.some(({ message }) => message.includes('rate set to 0.5')));
  await until(() => client.subscriptions.size > subscriptions);
  client.foxglove.subscribeParameterUpdates(['source/rate']);
  client.foxglove.setParameters([{ name: 'source/rate', value: 0.5 }, { name: 'source/shown', value: false }], 'set');
  assert.deepEqual(await answer('set'), [{ name: 'source/rate', value: 0.5, type: 'float64' }, { name: 'source/shown', value: false }]);
  await until(() => client.values.some(({ id, parameters }) => id === undefined && parameters[0].name === 'source/rate' && parameters[0].value === 0.5));
  client.foxglove.setParameters([{ name: 'source/rate', value: 7 }], 'refused');
  assert.deepEqual(await answer('refused'), [{ name: 'source/rate', value: 0.5, type: 'float64' }]);
  const status = client.statuses.find(({ message }) => message.includes("'rate'"));
  assert.equal(status.level, protocol.StatusLevel.ERROR);
  assert.match(status.message, /must be a number from 0 to 1, not '7'/);
  const line = (await log).find(({ message }) => message.includes('rate set to 0.5'));
  assert.equal(line.name, 'source');
  assert.equal(line.level, 2);
});

live('who publishes what, the time, and the model as a file', async () => {
  client.foxglove.subscribeConnectionGraph();
  await until(() => client.graphs.length > 0);
  assert.deepEqual(client.graphs[0].publishedTopics.find(({ name }) => name === 'scene/state').publisherIds, ['source']);
  await until(() => client.times.length > 2);
  assert.ok(client.times.every((time, i) => i === 0 || time > client.times[i - 1]));
  client.foxglove.fetchAsset('package://splatbus/model.ply', 3);
  client.foxglove.fetchAsset('package://elsewhere/robot.urdf', 4);
  await until(() => client.assets.length === 2);
  const [model, none] = [3, 4].map((id) => client.assets.find(({ requestId }) => requestId === id));
  assert.equal(Buffer.from(model.data.buffer, model.data.byteOffset, 4).toString(), 'ply\n');
  assert.equal(none.status, protocol.FetchAssetStatus.ERROR);
  assert.match(none.error, /model\.glb/);
  assert.equal(client.error, undefined);
});
