import { grown } from '../growing';
import { clamp } from '../math';
import type { ColorUpdate } from '../records';

/** Updates that wait for their time, and rows of all of them; where there are more the oldest begins at once. */
const kMostWaiting = 32;
const kMostRows = 1 << 24; // 128 MiB
/** Time that goes on by more than this at once was not shown in between. */
const kGapMs = 250;

/** What holds two sets of colors: see Renderer. */
export interface ColorHolder {
  recolor(update: ColorUpdate): void;
  keepColors(): void;
}

const known = (ms: number): number => (ms > 0 ? ms : -Infinity);

interface Waiting {
  readonly colors: ColorUpdate;
  /** When that was which they show, by the engine's clock; -Infinity: nobody knows. */
  ofMs: number;
  /** The time played out when they came. */
  readonly cameMs: number;
  readonly sequence: number;
}

/**
 * Colors of rows in the scene that they were shaded for: those to come begin when the time of those before has been played out,
 * and the picture goes from one to the other. What is shaded later may be of an earlier time, as shadows are, which come later than
 * their scene: no row goes back to colors that were shaded before those that it has.
 */
export class ColorPlayout {
  /** By ofMs, those of one time as they came. */
  #waiting: Waiting[] = [];
  /** Of all that wait. */
  #waitingRows = 0;
  #sequence = 0;
  /** By row, the sequence of what it was written by, where something older waits. */
  #written = new Uint32Array(0);
  #fromMs = -Infinity;
  #toMs = -Infinity;
  #sceneMs = 0;
  #shownMs = -Infinity;
  #part = 1;

  constructor(private readonly mostRows = kMostRows) {}

  /** All rows are new, with colors of this time. */
  restart(ofMs: number): void {
    this.#waiting = [];
    this.#waitingRows = 0;
    this.#fromMs = this.#toMs = known(ofMs);
    this.#part = 1;
  }

  /** Rows were written with newer colors than any that wait. */
  wrote(rows: Uint32Array): void {
    this.#stamp(rows, ++this.#sequence);
  }

  /** `sceneMs`: of the newest scene; none are of a later one. Nobody knows when that was of which the time is not above 0: it is shown at once. */
  add(colors: ColorUpdate, ofMs: number, sceneMs: number): void {
    if (sceneMs < this.#sceneMs) {
      for (const other of this.#waiting) other.ofMs = -Infinity; // of another engine, by another clock
      this.#toMs = -Infinity;
    }
    this.#sceneMs = sceneMs;
    // Of a later one they would be on their way for ever.
    this.#toMs = Math.min(this.#toMs, known(sceneMs));
    if (colors.rows.length === 0) return;
    const added = { colors, ofMs: known(Math.min(ofMs, sceneMs)), cameMs: this.#shownMs, sequence: ++this.#sequence };
    this.#waitingRows += colors.rows.length;
    const after = this.#waiting.findIndex((other) => other.ofMs > added.ofMs);
    this.#waiting.splice(after < 0 ? this.#waiting.length : after, 0, added);
  }

  /** Goes on to this time of the engine's clock, or to the newest there is where that is not known. True: there are other colors. */
  advance(shownMs: number | null, holder: ColorHolder): boolean {
    const now = shownMs ?? -Infinity;
    const jumped = Math.abs(now - this.#shownMs) > kGapMs;
    let any = false;
    for (let next = this.#waiting[0]; next && this.#isDue(next, shownMs); next = this.#waiting[0]) {
      this.#waiting.shift();
      this.#waitingRows -= next.colors.rows.length;
      if (next.ofMs > this.#toMs) {
        holder.keepColors();
        // Who comes too late for all of the way takes what is left of it.
        this.#fromMs = Math.max(this.#toMs, jumped ? now : next.cameMs);
        this.#toMs = next.ofMs;
      }
      holder.recolor(this.#newer(next));
      this.#stamp(next.colors.rows, next.sequence);
      any = true;
    }
    this.#shownMs = now;
    const way = this.#toMs - this.#fromMs;
    this.#part = shownMs !== null && way > 0 ? clamp((shownMs - this.#fromMs) / way, 0, 1) : 1;
    return any;
  }

  /** How far it is from the colors that are kept to those that there are. */
  get part(): number {
    return this.#part;
  }

  /** Other colors are on their way. */
  get moving(): boolean {
    return this.#waiting.length > 0 || this.#part < 1;
  }

  #isDue({ ofMs }: Waiting, shownMs: number | null): boolean {
    const tooMany = this.#waiting.length > kMostWaiting || this.#waitingRows > this.mostRows;
    return shownMs === null || ofMs <= this.#toMs || shownMs >= this.#toMs || tooMany;
  }

  #stamp(rows: Uint32Array, sequence: number): void {
    if (!this.#waiting.some((other) => other.sequence < sequence)) return;
    this.#written = grown(this.#written, rows.reduce((most, row) => Math.max(most, row + 1), 0));
    for (const row of rows) this.#written[row] = Math.max(this.#written[row], sequence);
  }

  /** Without the rows that have newer colors. */
  #newer({ colors, sequence }: Waiting): ColorUpdate {
    const isOlder = (row: number): boolean => (this.#written[row] ?? 0) > sequence;
    if (!colors.rows.some(isOlder)) return colors;
    const left = [...colors.rows.keys()].filter((index) => !isOlder(colors.rows[index]));
    return { rows: Uint32Array.from(left, (index) => colors.rows[index]), colors: Uint32Array.from(left, (index) => colors.colors[index]) };
  }
}
