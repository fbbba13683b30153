// Draws synthetic records by one of the renderers, for the tests that drive this page.
import { viewFromWorld, type View } from '../../src/math';
import { kRecordWords, type RowUpdate } from '../../src/records';
import type { Frame, Picture, Renderer } from '../../src/render/renderer';
import { RowMirror } from '../../src/stream/row_mirror';
import { Follower, loadWasm, Sorter, type Exports } from '../../src/stream/wasm';
import { makeRenderer } from '../../src/render/make_renderer';
import { playedColors } from './played_colors';
import { psnr, rgbOf, ssim } from './quality';
import { messagesOf, takeRows } from './recorded';
import { referenceOrder, referencePicture, linearOf, srgb } from './reference';
import { packRecords, syntheticScene, type SyntheticScene } from './synthetic_scene';

const kBackground = [0.1, 0.2, 0.4] as const;

export function testView(size: number, turn: number): View {
  const eye = [3 * Math.cos(turn), 1.2, 3 * Math.sin(turn)] as const;
  const towards = [-eye[0], 0.3 - eye[1], -eye[2]] as const;
  const far = Math.hypot(...towards);
  const forward = [towards[0] / far, towards[1] / far, towards[2] / far] as const;
  const focal = size / (2 * Math.tan(0.5));
  return { viewFromWorld: viewFromWorld(eye, forward), fx: focal, fy: focal, cx: size / 2 + 3, cy: size / 2 - 2, width: size, height: size };
}

const wholeUpdate = (scene: SyntheticScene): RowUpdate => {
  const count = scene.gaussians.length;
  return { rows: Uint32Array.from({ length: count }, (_, row) => row), records: scene.records, fades: new Float32Array(count) };
};

const frameOf = (scene: SyntheticScene, view: View): Frame => ({
  view,
  scene: { transforms: scene.transforms, farField: 0, player: 0, background: kBackground, displaySpace: false },
  resolution: 1,
  timeS: 1000,
  colorPart: 1,
  mip: true,
});

async function drawPoses(follower: Follower, renderer: Renderer, sorter: Sorter, poses: number[][]): Promise<string[]> {
  takeRows(follower, renderer, sorter);
  const scene = {
    transforms: follower.transforms.slice(),
    farField: follower.farFieldIndex,
    player: follower.playerIndex,
    background: follower.background,
    displaySpace: follower.stats.radiance,
  };
  sorter.setTransforms(scene.transforms, scene.farField);
  const pictures = [];
  for (const pose of poses) {
    const [fx, fy, cx, cy, width, height] = pose.slice(16);
    const view = { viewFromWorld: Float64Array.from(pose.slice(0, 16)), fx, fy, cx, cy, width, height };
    renderer.setOrder(sorter.sort(new Float32Array(view.viewFromWorld)).slice());
    pictures.push(await pngOf(await renderer.capture({ view, scene, resolution: 1, timeS: 1000, colorPart: 1, mip: true })));
  }
  return pictures;
}

/** A half float; of numbers below 65504 that are not negative. */
function halfOf(value: number): number {
  if (value < 2 ** -14) return Math.round(value * 2 ** 24);
  const exponent = Math.floor(Math.log2(value));
  return ((exponent + 15) << 10) | Math.round((value / 2 ** exponent - 1) * 1024);
}

async function pngOf(picture: Picture): Promise<string> {
  const canvas = new OffscreenCanvas(picture.width, picture.height);
  canvas.getContext('2d')!.putImageData(new ImageData(picture.rgba, picture.width, picture.height), 0, 0);
  const bytes = new Uint8Array(await (await canvas.convertToBlob()).arrayBuffer());
  return btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(''));
}

async function shown(renderer: Renderer, scene: SyntheticScene, view: View, mip = true): Promise<{ psnr: number; ssim: number; png: string }> {
  renderer.setOrder(referenceOrder(scene, view, mip));
  const frame = { ...frameOf(scene, view), mip };
  renderer.draw(frame);
  const picture = await renderer.capture(frame);
  const truth = referencePicture(scene, view, kBackground, mip);
  const rgb = rgbOf(picture);
  return { psnr: psnr(rgb, truth), ssim: ssim(rgb, truth, picture.width, picture.height), png: await pngOf(picture) };
}

let made: Renderer | null = null;
/** The page's renderer without rows. */
async function cleared(api: 'webgl2' | 'webgpu'): Promise<Renderer> {
  made ??= await makeRenderer(document.querySelector('canvas')!, api);
  made.clear();
  return made;
}

const tests = {
  /** How near the renderer's pictures are to the reference, from several sides. */
  async pictures(api: 'webgl2' | 'webgpu', count: number, size: number, mip: boolean): Promise<object[]> {
    const renderer = await cleared(api);
    const scene = syntheticScene(count);
    renderer.apply(wholeUpdate(scene));
    const results = [];
    for (const turn of [0.3, 2.2]) results.push(await shown(renderer, scene, testView(size, turn), mip));
    return results;
  },

  /** Rows that change later, some far beyond those that there were: only they are uploaded, and the picture is right. */
  async changes(api: 'webgl2' | 'webgpu'): Promise<{ rows: number[]; psnr: number }> {
    const renderer = await cleared(api);
    const before = syntheticScene(3000, 1);
    const after = syntheticScene(20000, 2);
    const first = renderer.uploaded.rows;
    renderer.apply(wholeUpdate(before));
    const rows = [renderer.uploaded.rows - first];
    // Of the first 3000 every third changes, and all that are new are added.
    const changed = after.gaussians.flatMap((_, row) => (row >= 3000 || row % 3 === 0 ? [row] : []));
    const records = new Uint32Array(kRecordWords * changed.length);
    changed.forEach((row, i) => records.set(after.records.subarray(kRecordWords * row, kRecordWords * (row + 1)), kRecordWords * i));
    renderer.apply({ rows: new Uint32Array(changed), records, fades: new Float32Array(changed.length) });
    rows.push(renderer.uploaded.rows - first);
    const mixed = { ...after, gaussians: after.gaussians.map((gaussian, row) => (row < 3000 && row % 3 !== 0 ? before.gaussians[row] : gaussian)) };
    return { rows, psnr: (await shown(renderer, mixed, testView(128, 1))).psnr };
  },

  /** Colors alone are replaced; then they are taken for display space, over a background that is linear all the same. */
  async colors(api: 'webgl2' | 'webgpu'): Promise<{ bytes: number; psnr: number; display: number }> {
    const renderer = await cleared(api);
    const scene = syntheticScene(3000, 1);
    renderer.apply(wholeUpdate(scene));
    const bytes = renderer.uploaded.bytes;
    const paint = syntheticScene(6000, 3).gaussians.slice(3000);
    scene.gaussians.forEach((gaussian, row) => (gaussian.color = paint[row].color));
    const records = packRecords(scene.gaussians);
    const rows = Uint32Array.from(scene.gaussians, (_, row) => row);
    renderer.recolor({ rows, colors: rows.map((row) => records[kRecordWords * row + 7]) });
    const replaced = renderer.uploaded.bytes - bytes;
    const view = testView(128, 1);
    const linear = await shown(renderer, scene, view);
    const frame = frameOf(scene, view);
    const picture = await renderer.capture({ ...frame, scene: { ...frame.scene, displaySpace: true } });
    const blended = kBackground.map(srgb) as [number, number, number];
    const truth = referencePicture(scene, view, blended).map((value) => 255 * linearOf(value / 255));
    return { bytes: replaced, psnr: linear.psnr, display: psnr(rgbOf(picture), truth) };
  },

  /** Between the scenes that colors are of, how near to the reference and how much was uploaded. */
  played: async (api: 'webgl2' | 'webgpu'): Promise<object[]> => playedColors(await cleared(api), testView(128, 1)),

  /** Rows on their way in or out are as opaque as the time says, a quarter of a second long. */
  async fading(api: 'webgl2' | 'webgpu'): Promise<{ since: number; atS: number; psnr: number }[]> {
    const results = [];
    for (const [since, atS, part] of [
      [10, 10, 0],
      [10, 10.0625, 0.25],
      [10, 10.125, 0.5],
      [10, 10.25, 1],
      [-10, 10.0625, 0.75],
      [-10, 10.125, 0.5],
      [-10, 10.25, 0],
    ]) {
      const renderer = await cleared(api);
      const scene = syntheticScene(2000, 4);
      renderer.apply({ ...wholeUpdate(scene), fades: new Float32Array(2000).fill(since) });
      const view = testView(128, 1);
      renderer.setOrder(referenceOrder(scene, view));
      const picture = await renderer.capture({ ...frameOf(scene, view), timeS: atS });
      const faded = { ...scene, gaussians: scene.gaussians.map((gaussian) => ({ ...gaussian, opacity: part * gaussian.opacity })) };
      results.push({ since, atS, psnr: psnr(rgbOf(picture), referencePicture(faded, view, kBackground)) });
    }
    return results;
  },

  /** An object that goes with the eye looks alike from everywhere. */
  async farField(api: 'webgl2' | 'webgpu'): Promise<number> {
    const renderer = await cleared(api);
    const scene = syntheticScene(2000, 5);
    scene.gaussians.forEach((gaussian) => (gaussian.object = 1));
    renderer.apply({ ...wholeUpdate(scene), records: packRecords(scene.gaussians) });
    const view = testView(96, 1);
    // The eye is 5 m up and 3 m aside of where it is in the reference's world, and so is the object.
    const moved = view.viewFromWorld.slice();
    for (const row of [0, 1, 2]) moved[4 * row + 3] -= 3 * moved[4 * row] + 5 * moved[4 * row + 1];
    const eye = [0, 1, 2].map((k) => -[0, 1, 2].reduce((sum, row) => sum + view.viewFromWorld[4 * row + k] * view.viewFromWorld[4 * row + 3], 0));
    const relative = scene.transforms.slice();
    [0, 1, 2].forEach((k) => (relative[12 + 4 * k + 3] -= eye[k]));
    renderer.setOrder(referenceOrder(scene, view));
    const frame = frameOf(scene, { ...view, viewFromWorld: moved });
    const picture = await renderer.capture({ ...frame, scene: { ...frame.scene, transforms: relative, farField: 1 } });
    return psnr(rgbOf(picture), referencePicture(scene, view, kBackground));
  },

  /** Where many are at one place, those of later rows are in front, however far apart their rows are. */
  async equalDepths(api: 'webgl2' | 'webgpu'): Promise<number> {
    const renderer = await cleared(api);
    const scene = syntheticScene(3000, 6);
    scene.gaussians.forEach((gaussian, row) => {
      const { mean, object } = scene.gaussians[row % 300];
      Object.assign(gaussian, { mean: [...mean], object });
    });
    const packed = { ...scene, records: packRecords(scene.gaussians) };
    renderer.apply(wholeUpdate(packed));
    return (await shown(renderer, packed, testView(128, 1))).psnr;
  },

  /** Pixels that differ from the background once the camera has turned away from everything. */
  async away(api: 'webgl2' | 'webgpu'): Promise<number> {
    const renderer = await cleared(api);
    const scene = syntheticScene(3000, 1);
    renderer.apply(wholeUpdate(scene));
    const view = testView(64, 1);
    await shown(renderer, scene, view);
    const turned = view.viewFromWorld.map((value, i) => (i < 4 || (i >= 8 && i < 12) ? -value : value));
    const away = { ...view, viewFromWorld: turned };
    renderer.setOrder(referenceOrder(scene, away));
    const { rgba } = await renderer.capture(frameOf(scene, away));
    const background = kBackground.map((value) => Math.round(255 * srgb(value)));
    return rgba.filter((value, i) => i % 4 < 3 && Math.abs(value - background[i % 4]) > 1).length;
  },

  /**
   * Harmonics that come when there is room for more rows than a device of the least limits could hold with them: how near to the
   * reference, how many buffers further rows take, and what is said when there are too many.
   */
  async lateHarmonics(): Promise<{ psnr: number; errors: string[]; buffers: number; lost: string }> {
    const { requestDevice } = GPUAdapter.prototype;
    const { createBuffer } = GPUDevice.prototype;
    let buffers = 0;
    const errors: string[] = [];
    GPUAdapter.prototype.requestDevice = async function () {
      const device = await requestDevice.call(this);
      device.addEventListener('uncapturederror', ({ error }) => errors.push(error.message));
      return device;
    };
    GPUDevice.prototype.createBuffer = function (...given) {
      ++buffers;
      return createBuffer.apply(this, given);
    };
    try {
      const renderer = await makeRenderer(document.createElement('canvas'), 'webgpu');
      const scene = syntheticScene(2000, 7);
      const view = testView(96, 1);
      const at = (first: number): RowUpdate => ({ ...wholeUpdate(scene), rows: Uint32Array.from(scene.gaussians, (_, row) => first + row) });
      renderer.apply(at(1_000_000)); // 32 bytes a row
      renderer.apply(at(1_380_000));
      await renderer.capture(frameOf(scene, view));
      renderer.clear();
      // Of degree 3, but for the constant band nothing: then colors are what they are without.
      const words = 24;
      const values = new Uint32Array(words * scene.gaussians.length);
      scene.gaussians.forEach(({ color: [r, g, b] }, row) => values.set([halfOf(r) | (halfOf(g) << 16), halfOf(b)], words * row));
      const radiant = (first: number): RowUpdate => ({ ...at(first), harmonics: { words, values } });
      renderer.apply(radiant(1_380_000));
      const near = psnr(rgbOf(await renderer.capture(frameOf(scene, view))), referencePicture(scene, view, kBackground));
      const before = buffers;
      for (let k = 0; k < 3; ++k) renderer.apply(radiant(1_390_000 + 1000 * k));
      const further = buffers - before;
      await renderer.finish();
      const said = [...errors];
      renderer.apply(radiant(1_400_000)); // 96 bytes each are more than 128 MiB
      return { psnr: near, errors: said, buffers: further, lost: await renderer.lost };
    } finally {
      Object.assign(GPUAdapter.prototype, { requestDevice });
      Object.assign(GPUDevice.prototype, { createBuffer });
    }
  },

  /** PNGs of a recorded stream, as base64: after so many messages each, from each of the poses. */
  async replay(api: 'webgl2' | 'webgpu', log: string, times: number[], poses: number[][]): Promise<string[][]> {
    const renderer = await cleared(api);
    const messages = messagesOf(await (await fetch(log)).arrayBuffer());
    const follower = new Follower(await loadWasm('splatbus.wasm'), 'replay', 4_000_000, 0);
    const sorter = new Sorter(await loadWasm('splatbus.wasm'));
    const pictures = [];
    let received = 0;
    for (const until of times) {
      for (; received < until; ++received) {
        if (follower.receive(messages[received], 0) !== 'received') throw new Error(follower.error);
        if (received % 7 !== 0) continue; // so that rows change more than once, as they do while frames are drawn
        takeRows(follower, renderer, sorter);
      }
      pictures.push(await drawPoses(follower, renderer, sorter, poses));
    }
    return pictures;
  },

  /** The hash of what is held after each message of a recorded stream, in hexadecimal digits. */
  async heldHashes(log: string): Promise<string[]> {
    const follower = new Follower(await loadWasm('splatbus.wasm'), 'replay', 4_000_000, 0);
    return messagesOf(await (await fetch(log)).arrayBuffer()).map((message) => {
      if (follower.receive(message, 0) !== 'received') throw new Error(follower.error);
      return follower.heldHash.toString(16).padStart(16, '0');
    });
  },

  /** Whether a camera of so many pixels each way is one. */
  async takesSides(sides: number[]): Promise<boolean[]> {
    const follower = new Follower(await loadWasm('splatbus.wasm'), 'sides', 1000, 0);
    return sides.map((side) => follower.setPose(new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, side, side, side / 2, side / 2, side, side])));
  },

  /** What a recorded model costs the workers of a page: milliseconds of sorts from all around, memory. */
  async million(log: string): Promise<object> {
    const [following, sorting] = [await loadWasm('splatbus.wasm'), await loadWasm('splatbus.wasm')];
    const follower = new Follower(following, 'measure', 4_000_000, 0);
    const sorter = new Sorter(sorting);
    const mirror = new RowMirror();
    const kRows = 65536; // as the stream worker hands them on
    for (const message of messagesOf(await (await fetch(log)).arrayBuffer())) {
      if (follower.receive(message, 0) !== 'received') throw new Error(follower.error);
      for (;;) {
        const changed = follower.takeChanges(kRows);
        const { rows } = changed;
        if (rows.length === 0) break;
        const update = mirror.take(changed, 1);
        sorter.update(follower.rowCapacity, update.rows, update.records);
        if (rows.length < kRows) break;
      }
    }
    sorter.setTransforms(follower.transforms.slice(), 0);
    const sortMs = [];
    for (let k = 0; k < 25; ++k) {
      const view = new Float32Array(testView(256, k).viewFromWorld);
      const start = performance.now();
      sorter.sort(view);
      sortMs.push(performance.now() - start);
    }
    const megabytes = (wasm: Exports): number => wasm.memory.buffer.byteLength / 2 ** 20;
    const { gaussians } = follower.stats;
    return { count: gaussians, sortMs, followerMb: megabytes(following), sorterMb: megabytes(sorting), mirrorMb: mirror.bytes / 2 ** 20 };
  },

  /** Milliseconds a frame, for whoever wants to know. */
  async speed(api: 'webgl2' | 'webgpu', count: number, size: number): Promise<number> {
    const renderer = await cleared(api);
    const scene = syntheticScene(count);
    renderer.apply(wholeUpdate(scene));
    const view = testView(size, 1);
    renderer.setOrder(referenceOrder(scene, view));
    const frame = frameOf(scene, view);
    await renderer.capture(frame);
    const start = performance.now();
    for (let i = 0; i < 3; ++i) await renderer.capture(frame);
    return (performance.now() - start) / 3;
  },
};

Object.assign(window, { tests });
