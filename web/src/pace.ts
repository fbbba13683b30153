import { clamp } from './math';

const kSlowestMs = 20; // 50 frames a second
const kQuickMs = 15;
const kLeast = 0.35;
const kJudgedFrames = 12;
/** A scene that lives stands still now and then, when its news come late: that is no rest yet. */
const kRestMs = 1000;

/** How fast pictures follow one another while something moves, and how fine they can be drawn for that. */
export class Pace {
  #last = 0;
  /** Nothing has moved since the last picture. */
  #paused = true;
  #intervals: number[] = [];
  #resolution = 1;
  #patience = 1;
  #quick = 0;
  frameMs = 0;

  /** Of the splats' own target; what a person chose replaces it. */
  get resolution(): number {
    return this.#resolution;
  }
  get framesPerSecond(): number {
    return this.frameMs > 0 ? 1000 / this.frameMs : 0;
  }

  /** A picture was drawn at `nowMs`. */
  drawn(nowMs: number): void {
    const interval = nowMs - this.#last;
    const isFirst = this.#paused;
    if (isFirst && this.restsAt(nowMs)) this.frameMs = 0;
    this.#last = nowMs;
    this.#paused = false;
    if (isFirst || interval <= 0) return;
    this.frameMs = this.frameMs === 0 ? interval : this.frameMs + 0.1 * (interval - this.frameMs);
    this.#intervals.push(interval);
    if (this.#intervals.length < kJudgedFrames) return;
    const middle = this.#intervals.sort((a, b) => a - b)[kJudgedFrames >> 1];
    this.#intervals = [];
    if (middle > kSlowestMs) {
      // Time goes with the pixels, so by the root along a side; what was tried in vain is not tried again soon.
      this.#resolution = clamp(this.#resolution * clamp(Math.sqrt(kSlowestMs / middle), 0.7, 0.95), kLeast, 1);
      this.#patience = Math.min(2 * this.#patience, 64);
      this.#quick = 0;
    } else if (this.#resolution < 1 && (middle < kQuickMs || ++this.#quick > this.#patience)) {
      this.#resolution = Math.min(this.#resolution * 1.1, 1);
      this.#quick = 0;
    }
  }

  /** Nothing moves: the next picture is the first of another series. */
  rest(): void {
    this.#intervals = [];
    this.#paused = true;
  }

  /** Whether nothing has moved for so long that there is no rate of pictures to speak of. */
  restsAt(nowMs: number): boolean {
    return this.#paused && nowMs - this.#last > kRestMs;
  }
}

/** Bytes a second over the last few seconds. */
export class Rate {
  #samples: { ms: number; bytes: number }[] = [];

  add(ms: number, bytes: number): void {
    const last = this.#samples.at(-1);
    if (last && bytes < last.bytes) this.#samples = []; // counted anew
    this.#samples.push({ ms, bytes });
    while (this.#samples.length > 2 && ms - this.#samples[0].ms > 3000) this.#samples.shift();
  }

  get megabits(): number {
    const first = this.#samples[0];
    const last = this.#samples.at(-1);
    if (!first || !last || last.ms <= first.ms) return 0;
    return (8 * (last.bytes - first.bytes)) / (1000 * (last.ms - first.ms));
  }
}
