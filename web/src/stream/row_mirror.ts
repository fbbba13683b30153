import { grown } from '../growing';
import { kTransformFloats, type Vec3 } from '../math';
import { kRecordWords, objectOf, opacityOf, type ColorUpdate, type RowUpdate, type Scene } from '../records';
import { kFadeS, kNoFade } from '../render/renderer';
import { pick, type Pointed } from './pick';

/** Rows that are sampled for the bounds. */
const kSampled = 20000;
/** Of the samples along each axis, this part on either side is left out. */
const kOutside = 0.03;

/** Rows as the model has them now. */
export type ChangedRows = Omit<RowUpdate, 'fades'>;
type Filled = Pick<RowUpdate, 'records' | 'harmonics'>;

/** The rows as they were handed on: for whoever has to begin anew, and to know which appear and which vanish. */
export class RowMirror {
  #records = new Uint32Array(0);
  #harmonics = new Uint32Array(0);
  #words = 0; // of harmonics
  #fades = new Float32Array(0);
  #used = 0;
  #vanishing: { row: number; sinceS: number }[] = [];
  #count = 0;

  /** Takes rows as the model has them; what vanishes is kept until it has faded. */
  take({ rows, records, harmonics }: ChangedRows, nowS: number): RowUpdate {
    if ((harmonics?.words ?? 0) !== this.#words) {
      this.#words = harmonics?.words ?? 0;
      this.#harmonics = new Uint32Array(0);
    }
    this.#reserve(rows.reduce((most, row) => Math.max(most, row + 1), this.#used));
    const update = {
      rows: rows.slice(),
      records: records.slice(),
      fades: new Float32Array(rows.length),
      harmonics: harmonics && { words: harmonics.words, values: harmonics.values.slice() },
    };
    rows.forEach((row, index) => {
      const wasThere = opacityOf(this.#records, row) > 0 && this.#fades[row] >= 0;
      const isThere = opacityOf(records, index) > 0;
      this.#count += Number(isThere) - Number(wasThere);
      if (wasThere && !isThere) {
        this.#copyOut(row, update, index);
        this.#fades[row] = -nowS;
        this.#vanishing.push({ row, sinceS: -this.#fades[row] });
      } else {
        if (isThere && !wasThere) this.#fades[row] = nowS;
        else if (!isThere && this.#fades[row] < 0) this.#copyOut(row, update, index);
        this.#copyIn(row, update, index);
      }
      update.fades[index] = this.#fades[row];
    });
    return update;
  }

  recolor(update: ColorUpdate): void {
    for (let index = 0; index < update.rows.length; ++index) {
      this.#records[kRecordWords * update.rows[index] + 7] = update.colors[index];
    }
  }

  /** Rows that have faded since, as free ones; null if there are none. */
  takeVanished(nowS: number): RowUpdate | null {
    if (this.#vanishing.length === 0) return null;
    let count = 0;
    while (count < this.#vanishing.length && this.#vanishing[count].sinceS + kFadeS <= nowS) ++count;
    const due = this.#vanishing.splice(0, count).filter(({ row, sinceS }) => this.#fades[row] === -sinceS);
    if (due.length === 0) return null;
    const rows = Uint32Array.from(due, ({ row }) => row);
    for (const row of rows) {
      this.#records.fill(0, kRecordWords * row, kRecordWords * (row + 1));
      this.#fades[row] = kNoFade;
    }
    return { ...this.#nothing(rows.length), rows };
  }

  /** Rows that are there, without those that vanish. */
  get count(): number {
    return this.#count;
  }

  get bytes(): number {
    return this.#records.byteLength + this.#harmonics.byteLength + this.#fades.byteLength;
  }

  /** Every row that is not free. */
  everything(): RowUpdate {
    const rows: number[] = [];
    for (let row = 0; row < this.#used; ++row) if (opacityOf(this.#records, row) > 0) rows.push(row);
    const update = { ...this.#nothing(rows.length), rows: new Uint32Array(rows), fades: Float32Array.from(rows, (row) => this.#fades[row]) };
    rows.forEach((row, index) => this.#copyOut(row, update, index));
    return update;
  }

  /** A sphere about most of what there is but for the far field; null while there is nothing. */
  bounds({ transforms, farField }: Scene): { centre: [number, number, number]; radius: number } | null {
    const step = Math.max(1, Math.floor(this.#used / kSampled));
    const means = new Float32Array(this.#records.buffer);
    const axes: [number[], number[], number[]] = [[], [], []];
    for (let row = 0; row < this.#used; row += step) {
      const object = objectOf(this.#records, row);
      const at = kTransformFloats * object;
      if (opacityOf(this.#records, row) === 0 || (farField !== 0 && object === farField) || at + kTransformFloats > transforms.length) continue;
      const world = [0, 1, 2].map((r) => {
        const of = at + 4 * r;
        const mean = kRecordWords * row;
        return transforms[of] * means[mean] + transforms[of + 1] * means[mean + 1] + transforms[of + 2] * means[mean + 2] + transforms[of + 3];
      });
      axes.forEach((axis, k) => axis.push(world[k]));
    }
    if (axes[0].length === 0) return null;
    const ranges = axes.map((axis) => {
      axis.sort((a, b) => a - b);
      const outside = Math.floor(axis.length * kOutside);
      return [axis[outside], axis[axis.length - 1 - outside]] as const;
    });
    const centre = ranges.map(([low, high]) => (low + high) / 2) as [number, number, number];
    const half = ranges.map(([low, high]) => (high - low) / 2);
    return { centre, radius: Math.max(Math.hypot(half[0], half[1], half[2]), 0.1) };
  }

  /** The surface that somebody points at; null: there is none. */
  pick(at: Pointed): Vec3 | null {
    return pick(this.#records, this.#fades, this.#used, at);
  }

  #nothing(rows: number): Omit<RowUpdate, 'rows'> {
    const words = this.#words;
    return {
      records: new Uint32Array(kRecordWords * rows),
      fades: new Float32Array(rows),
      harmonics: words > 0 ? { words, values: new Uint32Array(words * rows) } : undefined,
    };
  }
  #copyOut(row: number, { records, harmonics }: Filled, index: number): void {
    records.set(this.#records.subarray(kRecordWords * row, kRecordWords * (row + 1)), kRecordWords * index);
    harmonics?.values.set(this.#harmonics.subarray(this.#words * row, this.#words * (row + 1)), this.#words * index);
  }
  #copyIn(row: number, { records, harmonics }: Filled, index: number): void {
    this.#records.set(records.subarray(kRecordWords * index, kRecordWords * (index + 1)), kRecordWords * row);
    if (harmonics) this.#harmonics.set(harmonics.values.subarray(this.#words * index, this.#words * (index + 1)), this.#words * row);
  }

  #reserve(rows: number): void {
    this.#records = grown(this.#records, kRecordWords * rows);
    this.#harmonics = grown(this.#harmonics, this.#words * rows);
    this.#fades = grown(this.#fades, rows);
    this.#used = Math.max(this.#used, rows);
  }
}
