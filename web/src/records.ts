// What the GPU holds of a Gaussian: 32 bytes, eight little-endian words.
//   0 1 2  mean, f32, in its object's frame, metres
//   3      log scale x, y: i16 in steps of 1/1024
//   4      log scale z; rotation vector x: i16 in steps of pi / 32767
//   5      rotation vector y, z
//   6      opacity u8 (0: the row is free), object index u24 above it (into the transforms; 0 the world)
//   7      color, linear, rgb9e5
export const kRecordWords = 8;

/**
 * Colors that depend on where one looks from, in display space: [n][words], as [coefficient][RGB] of two half floats a word;
 * the first coefficient is the share that does not depend. Directions are from the eye to the mean, in the object's frame.
 */
export interface Harmonics {
  /** A multiple of four. */
  readonly words: number;
  readonly values: Uint32Array;
}

/** As an origin: in no row. */
export const kNoRow = 0xffffffff;
/** What has become of rows that changed. */
export interface Turnover {
  /** [n] In which row what is in each now was before, kNoRow where it was in none. */
  readonly origins: Uint32Array;
  /** [n] 1 where what was in it is in no row any more. */
  readonly left: Uint8Array;
}

/** Rows that changed. */
export interface RowUpdate {
  /** [n] ascending or not, each once. */
  readonly rows: Uint32Array;
  /** [n][kRecordWords] */
  readonly records: Uint32Array;
  /** [n] When the row began to show, in seconds of the page's clock, or, negative, began to vanish. */
  readonly fades: Float32Array;
  /** In place of the records' colors. */
  readonly harmonics?: Harmonics | undefined;
}

/** Rows of which the color alone changed. */
export interface ColorUpdate {
  readonly rows: Uint32Array;
  /** [n] rgb9e5 */
  readonly colors: Uint32Array;
}

/** What rows are shown under. */
export interface Scene {
  /** world_from_object, row-major 3x4, [count][12]; all zero for an object that is hidden. */
  readonly transforms: Float32Array;
  /** Index of the transform that goes with the eye; 0: there is none. */
  readonly farField: number;
  /** Index of the transform that is world_from_camera of the engine's player; 0: there is none. */
  readonly player: number;
  /** Linear. */
  readonly background: readonly [number, number, number];
  /** Colors are in display space and are blended there. */
  readonly displaySpace: boolean;
}

/** When a scene was: by the engine's clock where that is known, and when it arrived, by the page's. */
export interface SceneTime {
  readonly captureMs: number;
  readonly arrivedMs: number;
  /** When it was that colors show, as captureMs: shadows come later than the scene that they are of. */
  readonly colorsMs: number;
}

export const kNoScene: Scene = { transforms: new Float32Array(0), farField: 0, player: 0, background: [0, 0, 0], displaySpace: false };

export const opacityOf = (records: Uint32Array, index: number): number => records[kRecordWords * index + 6] & 0xff;
/** Of the largest axis, as the record has it. */
export const logSizeOf = (records: Uint32Array, index: number): number => {
  const xy = records[kRecordWords * index + 3];
  return Math.max((xy << 16) >> 16, xy >> 16, (records[kRecordWords * index + 4] << 16) >> 16);
};
export const objectOf = (records: Uint32Array, index: number): number => records[kRecordWords * index + 6] >>> 8;
