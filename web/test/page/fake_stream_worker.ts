// Stands in for the stream worker in the tests of the page: the same messages, of a scene that no engine made.
import { kNoRow, type Turnover } from '../../src/records';
import type { EnginePicture, FromStreamWorker, StreamFigures, ToStreamWorker, WorkerScope } from '../../src/stream/messages';
import { Publisher } from '../../src/stream/publisher';
import { referencePicture } from './reference';
import { packRecords, syntheticScene } from './synthetic_scene';

const scope = self as unknown as WorkerScope<ToStreamWorker, FromStreamWorker>;
const scene = syntheticScene(3000);
const world = { transforms: scene.transforms, farField: 0, player: 0, background: [0.1, 0.2, 0.4] as const, displaySpace: false };
let state = world;
const kUntimed = { captureMs: 0, arrivedMs: 0, colorsMs: 0 };
let time = kUntimed;
const turnoverOf = (origins: Uint32Array): Turnover => ({ origins, left: new Uint8Array(origins.length) });
const nothing = { rows: new Uint32Array(0), records: new Uint32Array(0), turnover: turnoverOf(new Uint32Array(0)) };
const noColors = { rows: new Uint32Array(0), colors: new Uint32Array(0) };
let clockOriginMs = performance.timeOrigin;
let publisher: Publisher;
let poses = 0;
let held = 0;

const figures = (): StreamFigures => ({
  atMs: performance.now(),
  gaussians: held,
  sequence: poses,
  epoch: 1,
  sceneVersion: 1,
  missing: held < scene.gaussians.length ? 7 : 0,
  bytes: 32 * held,
  ageMs: 5,
  roundTripMs: 1,
});

/** What an engine would answer: the scene in double precision. */
function engineDraws(probeId: number, floats: Float32Array): EnginePicture {
  const [fx, fy, cx, cy, width, height] = floats.subarray(16);
  const view = { viewFromWorld: Float64Array.from(floats.subarray(0, 16)), fx, fy, cx, cy, width, height };
  const rgb = referencePicture(scene, view, state.background);
  const rgba = new Uint8ClampedArray(4 * width * height).fill(255);
  for (let i = 0; i < width * height; ++i) rgba.set(rgb.subarray(3 * i, 3 * i + 3), 4 * i);
  return { probeId, width, height, rgba, transforms: state.transforms.slice() };
}

/** A few rows change: what the test says to a channel of its own. */
new BroadcastChannel('change').onmessage = ({ data }: MessageEvent<number>) => {
  const rows = Uint32Array.from({ length: data }, (_, row) => row);
  publisher.publish({ rows, records: scene.records.slice(0, 8 * data), turnover: turnoverOf(rows) }, noColors, state, time, true);
};

/** All rows in another light, of a scene that was then. */
new BroadcastChannel('light').onmessage = ({ data }: MessageEvent<{ ms: number; arrivedMs: number; part: number }>) => {
  const lit = packRecords(scene.gaussians.map((gaussian) => ({ ...gaussian, color: [data.part, data.part, data.part] })));
  const rows = Uint32Array.from(scene.gaussians, (_, row) => row);
  const colors = { rows, colors: rows.map((row) => lit[8 * row + 7]) };
  time = { captureMs: data.ms, colorsMs: data.ms, arrivedMs: data.arrivedMs };
  publisher.publish(nothing, colors, state, time, true);
};

/** A player's camera, world_from_camera [3][4]; null: the player is gone. */
new BroadcastChannel('player').onmessage = ({ data }: MessageEvent<number[] | null>) => {
  state = data ? { ...world, transforms: new Float32Array([...scene.transforms, ...data]), player: scene.transforms.length / 12 } : world;
  publisher.publish(nothing, noColors, state, kUntimed, true);
};
/** The connection is lost, to be tried again in so many seconds; 0: it is there again. */
new BroadcastChannel('connection').onmessage = ({ data }: MessageEvent<number>) =>
  scope.postMessage({ kind: 'connection', state: data > 0 ? 'waiting' : 'open', retryS: data });
/** The worker cannot go on, for this reason. */
new BroadcastChannel('fail').onmessage = ({ data }: MessageEvent<string>) => scope.postMessage({ kind: 'failed', reason: data });
const asked = new BroadcastChannel('asked');

scope.onmessage = ({ data }) => {
  if (data.kind === 'start') {
    clockOriginMs = data.clockOriginMs;
    publisher = new Publisher(() => (performance.timeOrigin + performance.now() - clockOriginMs) / 1000, data.budget.gaussians);
    // What there is no room for never comes.
    held = Math.min(scene.gaussians.length, data.budget.gaussians);
    const rows = Uint32Array.from({ length: held }, (_, row) => row);
    publisher.publish({ rows, records: scene.records.slice(0, 8 * held), turnover: turnoverOf(rows.map(() => kNoRow)) }, noColors, state, kUntimed, held === scene.gaussians.length);
    scope.postMessage({ kind: 'connection', state: 'open', retryS: 0 });
  } else if (data.kind === 'attach') {
    publisher.attach(data.port, data.shown);
  } else if (data.kind === 'taken') {
    for (let i = 0; i < data.batches; ++i) publisher.taken();
  } else if (data.kind === 'pose') {
    ++poses;
    scope.postMessage({ kind: 'figures', figures: figures() });
  } else if (data.kind === 'probe') {
    scope.postMessage({ kind: 'picture', picture: engineDraws(data.probeId, data.floats) });
  } else if (data.kind === 'rate') {
    asked.postMessage(data.megabits);
  } else if (data.kind === 'bounds') {
    const bounds = publisher.bounds();
    if (bounds) scope.postMessage({ kind: 'bounds', ...bounds });
  } else if (data.kind === 'pick') {
    scope.postMessage({ kind: 'pick', number: data.number, point: publisher.pick(data.at) });
  }
};
