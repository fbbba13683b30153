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

/** Rows of what vanishes, behind all that the model has. */
const kMostSpareRows = 32768;

/** Rows as the model has them now. */
export type ChangedRows = Omit<RowUpdate, 'fades'> & { readonly turnover: Turnover };
type Filled = Pick<RowUpdate, 'records' | 'harmonics'>;

/** Records, and the places of their means among them. */
class Records {
  readonly #means: Float32Array;

  constructor(readonly words: Uint32Array) {
    this.#means = new Float32Array(words.buffer, words.byteOffset, words.length);
  }

  /**
   * Whether one stands for the other, so that to see both would be too much: a page that came whole has most of its Gaussians again,
   * about where they were.
   */
  resembles(index: number, other: Records, otherIndex: number): boolean {
    const [size, otherSize] = [logSizeOf(this.words, index), logSizeOf(other.words, otherIndex)];
    if (objectOf(this.words, index) !== objectOf(other.words, otherIndex) || Math.abs(size - otherSize) >= kLogTwo) return false;
    let squared = 0;
    for (let axis = 0; axis < 3; ++axis) squared += (this.#means[kRecordWords * index + axis] - other.#means[kRecordWords * otherIndex + axis]) ** 2;
    return squared < (kNear * Math.exp(kLogScaleStep * Math.min(size, otherSize))) ** 2;
  }
}

/** What left while another took its row: where it has to vanish is found later. */
class Displaced {
  readonly fades: number[] = [];
  readonly records: Uint32Array;
  readonly harmonics: Uint32Array;

  constructor(
    most: number,
    private readonly words: number,
  ) {
    this.records = new Uint32Array(kRecordWords * most);
    this.harmonics = new Uint32Array(words * most);
  }

  add(records: Uint32Array, harmonics: Uint32Array, row: number, fade: number): void {
    const at = this.fades.length;
    this.records.set(records.subarray(kRecordWords * row, kRecordWords * (row + 1)), kRecordWords * at);
    this.harmonics.set(harmonics.subarray(this.words * row, this.words * (row + 1)), this.words * at);
    this.fades.push(fade);
  }
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
  /** Rows behind the model's that are free, or were: it may have come to have them. */
  readonly #spare: number[] = [];
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
      fades: this.#fadesOf(turnover.origins),
      harmonics: harmonics && { words: harmonics.words, values: harmonics.values.slice() },
    };
    const [held, taken] = [new Records(this.#records), new Records(records)];
    let displaced: Displaced | null = null;
    rows.forEach((row, index) => {
      const was = opacityOf(this.#records, row) > 0;
      const is = opacityOf(records, index) > 0;
      const vanishes = was && this.#fades[row] < 0;
      const origin = turnover.origins[index];
      const leaves = was && (vanishes || turnover.left[index] !== 0 || (!is && origin === row));
      this.#count += Number(is) - Number(was && !vanishes);
      if (leaves && !is) {
        this.#copyOut(row, update, index);
        if (!vanishes) this.#vanish(row, -nowS);
        update.fades[index] = this.#fades[row];
        return;
      }
      const arrives = is && origin === kNoRow;
      const standsIn = leaves && arrives && !vanishes && held.resembles(row, taken, index);
      if (leaves && !standsIn && !(vanishes && kFadeS - this.#fades[row] <= nowS)) {
        displaced ??= new Displaced(rows.length - index, this.#words);
        displaced.add(this.#records, this.#harmonics, row, vanishes ? this.#fades[row] : -nowS);
      }
      if (standsIn) update.fades[index] = this.#fades[row];
      else if (arrives) update.fades[index] = nowS;
      this.#fades[row] = update.fades[index];
      this.#copyIn(row, update, index);
    });
    return displaced ? this.#placed(displaced, update) : update;
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
    const rows = new Uint32Array(count);
    let due = 0;
    for (const { row, sinceS } of this.#vanishing.splice(0, count)) {
      if (this.#fades[row] !== -sinceS) continue; // it came back
      this.#records.fill(0, kRecordWords * row, kRecordWords * (row + 1));
      this.#fades[row] = kNoFade;
      if (row >= this.#model) this.#spare.push(row);
      rows[due++] = row;
    }
    if (due === 0) return null;
    return { ...this.#nothing(due), rows: rows.subarray(0, due) };
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

  /** Of who moves his fade goes on. */
  #fadesOf(origins: Uint32Array): Float32Array<ArrayBuffer> {
    const fades = new Float32Array(origins.length);
    for (let index = 0; index < fades.length; ++index) {
      if (origins[index] < this.#used) fades[index] = Math.max(this.#fades[origins[index]], kNoFade);
    }
    return fades;
  }

  /** With those that were displaced in rows that nobody has: of the update, or behind the model's. */
  #placed(displaced: Displaced, update: RowUpdate): RowUpdate {
    const count = displaced.fades.length;
    const homes: number[] = []; // indices of the update, rows of which nothing is left
    for (let index = 0; index < update.rows.length && homes.length < count; ++index) {
      if (opacityOf(update.records, index) === 0) homes.push(index);
    }
    const more = this.#spareRows(count - homes.length);
    const rows = new Uint32Array(update.rows.length + more.length);
    const all = { ...this.#nothing(rows.length), rows };
    rows.set(update.rows);
    rows.set(more, update.rows.length);
    all.records.set(update.records);
    all.fades.set(update.fades);
    if (update.harmonics) all.harmonics?.values.set(update.harmonics.values);
    for (let k = 0; k < more.length; ++k) homes.push(update.rows.length + k);
    homes.forEach((index, k) => {
      const row = rows[index];
      this.#vanish(row, displaced.fades[k]); // those that vanished already come late: nothing of them is seen by then
      all.fades[index] = this.#fades[row];
      this.#records.set(displaced.records.subarray(kRecordWords * k, kRecordWords * (k + 1)), kRecordWords * row);
      this.#harmonics.set(displaced.harmonics.subarray(this.#words * k, this.#words * (k + 1)), this.#words * row);
      this.#copyOut(row, all, index);
    });
    return all;
  }

  /** As many as there are of so many; the rest vanishes at once. */
  #spareRows(count: number): number[] {
    const rows: number[] = [];
    while (rows.length < count && this.#spare.length > 0) {
      const row = this.#spare.pop() as number;
      if (row >= this.#model) rows.push(row);
    }
    const first = this.#used;
    this.#reserve(Math.max(first, Math.min(this.#model + kMostSpareRows, first + count - rows.length)));
    for (let row = first; row < this.#used; ++row) rows.push(row);
    return rows;
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
