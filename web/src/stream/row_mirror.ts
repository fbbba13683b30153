import { grown } from '../growing';
import { kTransformFloats, type Vec3 } from '../math';
import { kNoRow, kRecordWords, logSizeOf, objectOf, opacityOf, type ColorUpdate, type RowUpdate, type Scene, type Turnover } from '../records';
import { kFadeS, kNoFade } from '../render/renderer';
import { pick, type Pointed } from './pick';

/** Rows that are sampled for the bounds. */
const kSampled = 20000;
/** Of the samples along each axis, this part on either side is left out. */
const kOutside = 0.03;

const kLogScaleStep = 1 / 1024;
/** Of what stands for another: how much larger it may be, in steps of its log scale, and how far away, of its size. */
const kLogTwo = 710;
const kNear = 0.25;

/** Rows of what vanishes, behind all that the model has: at least so many, or a part of all. */
const kLeastSpareRows = 4096;
const kSpareShare = 1 / 4;

/** Rows as the model has them now. */
export type ChangedRows = Omit<RowUpdate, 'fades'> & { readonly turnover: Turnover };
type Filled = Pick<RowUpdate, 'records' | 'harmonics'>;
interface Displaced extends Filled {
  readonly fade: number;
}

const meanOf = (records: Uint32Array, index: number): Float32Array => new Float32Array(records.buffer, records.byteOffset + 4 * kRecordWords * index, 3);

/**
 * Whether one stands for the other, so that to see both would be too much: a page that came whole has most of its Gaussians again,
 * about where they were.
 */
function resembles(a: Uint32Array, i: number, b: Uint32Array, k: number): boolean {
  const [sizeA, sizeB] = [logSizeOf(a, i), logSizeOf(b, k)];
  if (objectOf(a, i) !== objectOf(b, k) || Math.abs(sizeA - sizeB) >= kLogTwo) return false;
  const [from, to] = [meanOf(a, i), meanOf(b, k)];
  return Math.hypot(to[0] - from[0], to[1] - from[1], to[2] - from[2]) < kNear * Math.exp(kLogScaleStep * Math.min(sizeA, sizeB));
}

/**
 * The rows as they were handed on: for whoever has to begin anew, and to let Gaussians fade that arrive or leave. Whoever leaves while
 * another takes his row vanishes in a free one.
 */
export class RowMirror {
  #records = new Uint32Array(0);
  #harmonics = new Uint32Array(0);
  #words = 0; // of harmonics
  #fades = new Float32Array(0);
  #used = 0;
  /** Of #used, those that the model has had. */
  #model = 0;
  #vanishing: { row: number; sinceS: number }[] = [];
  /** Where the search for free rows goes on. */
  #cursor = 0;
  #count = 0;

  /** Takes rows as the model has them; what vanishes is kept until it has faded. */
  take({ rows, records, turnover, harmonics }: ChangedRows, nowS: number): RowUpdate {
    if ((harmonics?.words ?? 0) !== this.#words) {
      this.#words = harmonics?.words ?? 0;
      this.#harmonics = new Uint32Array(0);
    }
    this.#model = rows.reduce((most, row) => Math.max(most, row + 1), this.#model);
    this.#reserve(this.#model);
    const update = {
      rows: rows.slice(),
      records: records.slice(),
      // Who moves goes on with his fade.
      fades: Float32Array.from(turnover.origins, (row) => Math.max(this.#fades[row] ?? kNoFade, kNoFade)),
      harmonics: harmonics && { words: harmonics.words, values: harmonics.values.slice() },
    };
    const displaced: Displaced[] = [];
    rows.forEach((row, index) => {
      const was = opacityOf(this.#records, row) > 0;
      const is = opacityOf(records, index) > 0;
      const vanishes = was && this.#fades[row] < 0;
      const leaves = was && (vanishes || turnover.left[index] !== 0);
      this.#count += Number(is) - Number(was && !vanishes);
      if (leaves && !is) {
        this.#copyOut(row, update, index);
        if (!vanishes) this.#vanish(row, -nowS);
        update.fades[index] = this.#fades[row];
        return;
      }
      const replaced = leaves && is && (vanishes || !resembles(this.#records, row, records, index));
      if (replaced) displaced.push(this.#displaced(row, vanishes ? this.#fades[row] : -nowS));
      if (is && turnover.origins[index] === kNoRow && (!leaves || replaced)) update.fades[index] = nowS;
      this.#fades[row] = update.fades[index];
      this.#copyIn(row, update, index);
    });
    return displaced.length > 0 ? this.#placed(displaced, update) : update;
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

  #vanish(row: number, fade: number): void {
    this.#fades[row] = fade;
    this.#vanishing.push({ row, sinceS: -this.#fades[row] });
  }

  #displaced(row: number, fade: number): Displaced {
    const words = this.#words;
    return {
      fade,
      records: this.#records.slice(kRecordWords * row, kRecordWords * (row + 1)),
      harmonics: words > 0 ? { words, values: this.#harmonics.slice(words * row, words * (row + 1)) } : undefined,
    };
  }

  /** With those that were displaced in rows that nobody has, behind all others where there are none. */
  #placed(displaced: Displaced[], update: RowUpdate): RowUpdate {
    const taken = new Uint8Array(this.#used);
    const homes: number[] = []; // indices of the update, rows of which nothing is left
    update.rows.forEach((row, index) => {
      taken[row] = 1;
      if (homes.length < displaced.length && opacityOf(update.records, index) === 0) homes.push(index);
    });
    const more: number[] = [];
    for (let seen = 0; seen < this.#used && homes.length + more.length < displaced.length; ++seen) {
      this.#cursor = (this.#cursor + 1) % this.#used;
      if (taken[this.#cursor] === 0 && opacityOf(this.#records, this.#cursor) === 0) more.push(this.#cursor);
    }
    const most = this.#model + Math.max(kLeastSpareRows, Math.floor(kSpareShare * this.#model));
    // Beyond them the rest vanishes at once.
    for (let row = this.#used; row < most && homes.length + more.length < displaced.length; ++row) more.push(row);
    this.#reserve(more.reduce((used, row) => Math.max(used, row + 1), this.#used));
    const all = { ...this.#nothing(update.rows.length + more.length), rows: new Uint32Array(update.rows.length + more.length) };
    all.rows.set(update.rows);
    all.rows.set(more, update.rows.length);
    all.records.set(update.records);
    all.fades.set(update.fades);
    if (update.harmonics) all.harmonics?.values.set(update.harmonics.values);
    homes.push(...more.map((_, k) => update.rows.length + k));
    homes.forEach((index, k) => {
      const row = all.rows[index];
      const one = displaced[k];
      this.#vanish(row, one.fade); // those that vanished already come late: nothing of them is seen by then
      all.fades[index] = this.#fades[row];
      this.#records.set(one.records, kRecordWords * row);
      if (one.harmonics) this.#harmonics.set(one.harmonics.values, this.#words * row);
      this.#copyOut(row, all, index);
    });
    return all;
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
