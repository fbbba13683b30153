import { grown } from '../growing';
import { kTransformFloats } from '../math';
import { kRecordWords, objectOf, opacityOf } from '../records';
import type { SceneBatch } from './messages';

const kNear = 0.05;
const kBuckets = 2048;
const kFirstBits = 11;
/** Depth keys: the bits of a float above those of 2^-5 m, less these; 22 bits are left. */
const kDropped = 6;
const kKeyOrigin = 0x3d000000;
const kMostKey = kBuckets * kBuckets - 1;

/** Where every row is in the world, and which are seen from somewhere, far to near. Ties keep the order of rows. */
export class DepthSorter {
  #local = new Float32Array(0); // x y z, in the object's frame
  #world = new Float32Array(0);
  #object = new Uint32Array(0);
  #shown = new Uint8Array(0);
  #used = 0;
  #transforms = new Float32Array(0);
  #keys = new Uint32Array(0);
  #seen = new Uint32Array(0);
  #half = new Uint32Array(0);
  readonly #depth = new Float32Array(1);
  readonly #depthBits = new Uint32Array(this.#depth.buffer);

  apply(batch: SceneBatch): void {
    if (batch.whole) this.#shown.fill(0);
    const { rows, records } = batch.update;
    this.#reserve(rows.reduce((most, row) => Math.max(most, row + 1), this.#used));
    const means = new Float32Array(records.buffer, records.byteOffset, records.length);
    for (let index = 0; index < rows.length; ++index) {
      const row = rows[index];
      this.#shown[row] = opacityOf(records, index) > 0 ? 1 : 0;
      this.#object[row] = objectOf(records, index);
      for (let k = 0; k < 3; ++k) this.#local[3 * row + k] = means[kRecordWords * index + k];
    }
    this.#moveObjects(batch.scene.transforms);
    for (const row of rows) this.#place(row);
  }

  sort(viewFromWorld: Float64Array): Uint32Array {
    const [x, y, z, w] = viewFromWorld.subarray(8, 12);
    const low = new Uint32Array(kBuckets);
    const high = new Uint32Array(kBuckets);
    let count = 0;
    for (let row = 0; row < this.#used; ++row) {
      if (this.#shown[row] === 0) continue;
      const depth = x * this.#world[3 * row] + y * this.#world[3 * row + 1] + z * this.#world[3 * row + 2] + w;
      if (!(depth > kNear)) continue;
      this.#depth[0] = depth;
      // Far first.
      const key = kMostKey - Math.min((this.#depthBits[0] - kKeyOrigin) >>> kDropped, kMostKey);
      this.#keys[row] = key;
      this.#seen[count++] = row;
      ++low[key & (kBuckets - 1)];
      ++high[key >>> kFirstBits];
    }
    for (let bucket = 0, a = 0, b = 0; bucket < kBuckets; ++bucket) {
      const [inLow, inHigh] = [low[bucket], high[bucket]];
      low[bucket] = a;
      high[bucket] = b;
      a += inLow;
      b += inHigh;
    }
    for (let i = 0; i < count; ++i) {
      const row = this.#seen[i];
      this.#half[low[this.#keys[row] & (kBuckets - 1)]++] = row;
    }
    const order = new Uint32Array(count);
    for (let i = 0; i < count; ++i) {
      const row = this.#half[i];
      order[high[this.#keys[row] >>> kFirstBits]++] = row;
    }
    return order;
  }

  #moveObjects(transforms: Float32Array): void {
    const before = this.#transforms;
    const moved = new Uint8Array(transforms.length / kTransformFloats);
    for (let i = 0; i < transforms.length; ++i) {
      if (transforms[i] !== before[i]) moved[Math.floor(i / kTransformFloats)] = 1;
    }
    this.#transforms = transforms.slice();
    if (!moved.includes(1)) return;
    for (let row = 0; row < this.#used; ++row) if (moved[this.#object[row]] === 1) this.#place(row);
  }

  #place(row: number): void {
    const at = kTransformFloats * this.#object[row];
    const t = this.#transforms;
    const l = this.#local;
    for (let k = 0; k < 3; ++k) {
      const of = at + 4 * k;
      this.#world[3 * row + k] = t[of] * l[3 * row] + t[of + 1] * l[3 * row + 1] + t[of + 2] * l[3 * row + 2] + t[of + 3];
    }
  }

  #reserve(rows: number): void {
    this.#local = grown(this.#local, 3 * rows);
    this.#world = grown(this.#world, 3 * rows);
    this.#object = grown(this.#object, rows);
    this.#shown = grown(this.#shown, rows);
    this.#keys = grown(this.#keys, rows);
    this.#seen = grown(this.#seen, rows);
    this.#half = grown(this.#half, rows);
    this.#used = Math.max(this.#used, rows);
  }
}
