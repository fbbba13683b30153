// Colors that come with scenes, on a clock that the test makes.
import type { View } from '../../src/math';
import { ColorPlayout } from '../../src/motion/color_playout';
import { kRecordWords, type ColorUpdate } from '../../src/records';
import type { Renderer } from '../../src/render/renderer';
import { psnr, rgbOf } from './quality';
import { referenceOrder, referencePicture } from './reference';
import { packRecords, syntheticScene, type SyntheticScene } from './synthetic_scene';

const kRows = 3000;
const kBackground = [0.1, 0.2, 0.4] as const;
type Colors = readonly (readonly [number, number, number])[];

interface Judged {
  shownMs: number;
  psnr: number;
  bytes: number;
  /** Bytes that may have been uploaded until then. */
  due: number;
}

/** Other colors for the rows of a scene, as they are after packing. */
function paintOf(seed: number): { colors: Colors; words: Uint32Array } {
  const painted = syntheticScene(2 * kRows, seed).gaussians.slice(kRows);
  const records = packRecords(painted);
  return { colors: painted.map(({ color }) => color), words: Uint32Array.from(painted, (_, row) => records[kRecordWords * row + 7]) };
}

const mixed = (from: Colors, to: Colors, part: number): Colors =>
  from.map((color, row) => color.map((value, c) => value + (to[row][c] - value) * part) as [number, number, number]);

/** At 1000 ms in the scene's own colors, at 1100 in others, at 1200 every third row in others again. */
export async function playedColors(renderer: Renderer, view: View): Promise<Judged[]> {
  const scene = syntheticScene(kRows, 1);
  const first: Colors = scene.gaussians.map(({ color }) => [...color]);
  const [second, paint] = [paintOf(3), paintOf(5)];
  const third = second.colors.map((color, row) => (row % 3 === 0 ? paint.colors[row] : color));
  const rows = Uint32Array.from({ length: kRows }, (_, row) => row);
  const thirds = rows.filter((row) => row % 3 === 0);
  const playout = new ColorPlayout();
  renderer.apply({ rows, records: scene.records, fades: new Float32Array(kRows) });
  playout.restart(1000);
  renderer.setOrder(referenceOrder(scene, view));
  const before = renderer.uploaded.bytes;
  const judged: Judged[] = [];
  const judge = async (shownMs: number, colors: Colors, due: number): Promise<void> => {
    playout.advance(shownMs, renderer);
    const { transforms } = scene;
    const shown = { transforms, farField: 0, player: 0, background: kBackground, displaySpace: false };
    const picture = await renderer.capture({ view, scene: shown, resolution: 1, timeS: 1000, colorPart: playout.part, mip: true });
    const truth: SyntheticScene = { ...scene, gaussians: scene.gaussians.map((gaussian, row) => ({ ...gaussian, color: [...colors[row]] })) };
    judged.push({ shownMs, psnr: psnr(rgbOf(picture), referencePicture(truth, view, kBackground)), bytes: renderer.uploaded.bytes - before, due });
  };
  const add = (update: ColorUpdate, ofMs: number): void => playout.add(update, ofMs, ofMs);

  await judge(980, first, 0);
  add({ rows, colors: second.words }, 1100);
  await judge(990, first, 0);
  await judge(1000, first, 8 * kRows);
  await judge(1050, mixed(first, second.colors, 0.5), 8 * kRows);
  add({ rows: thirds, colors: Uint32Array.from(thirds, (row) => paint.words[row]) }, 1200);
  await judge(1075, mixed(first, second.colors, 0.75), 8 * kRows);
  await judge(1100, second.colors, 8 * (kRows + thirds.length));
  await judge(1150, mixed(second.colors, third, 0.5), 8 * (kRows + thirds.length));
  // Some are written meanwhile, one so far away that all have to be moved.
  const sevenths = Uint32Array.from([...rows.filter((row) => row % 7 === 0), 100_000]);
  const records = new Uint32Array(kRecordWords * sevenths.length);
  sevenths.forEach((row, i) => records.set(scene.records.subarray(kRecordWords * row, kRecordWords * (row + 1)), kRecordWords * i));
  renderer.apply({ rows: sevenths, records, fades: new Float32Array(sevenths.length) });
  playout.wrote(sevenths);
  const written = (colors: Colors): Colors => colors.map((color, row) => (row % 7 === 0 ? first[row] : color));
  await judge(1160, written(mixed(second.colors, third, 0.6)), 8 * (kRows + thirds.length) + 40 * sevenths.length);
  await judge(1230, written(third), 8 * (kRows + thirds.length) + 40 * sevenths.length);
  return judged;
}
