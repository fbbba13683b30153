// What the GPU holds of a Gaussian: 32 bytes, eight little-endian words.
//   0 1 2  mean, f32, in its object's frame, metres
//   3      log scale x, y: i16 in steps of 1/1024
//   4      log scale z; rotation vector x: i16 in steps of pi / 32767
//   5      rotation vector y, z
//   6      opacity u8 (0: the row is free), object index u24 above it (into the transforms; 0 the world)
//   7      colour, linear, rgb9e5
export const kRecordWords = 8;

/** Rows that changed. A row keeps its Gaussian until that is removed. */
export interface RowUpdate {
  /** [n] ascending or not, each once. */
  readonly rows: Uint32Array;
  /** [n][kRecordWords] */
  readonly records: Uint32Array;
  /** [n] When the row began to show, in seconds of the page's clock, or, negative, began to vanish. */
  readonly fades: Float32Array;
}

export const opacityOf = (records: Uint32Array, index: number): number => records[kRecordWords * index + 6] & 0xff;
export const objectOf = (records: Uint32Array, index: number): number => records[kRecordWords * index + 6] >>> 8;
