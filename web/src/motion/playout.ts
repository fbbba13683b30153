import { clamp, kTransformFloats, mix } from '../math';
import type { Scene, SceneTime } from '../records';
import { mixTransform } from './turning';

/** Scenes that are kept, for the ones between which it is now, and for how late they come. */
const kKept = 16;
const kMostDelayMs = 200;
/** Beyond the last scene things go on as they went for as long, then rest. */
const kBeyondMs = 100;
/** Scenes further apart than this are not of one motion. */
const kGapMs = 250;
/** The delay shrinks by this part of what is too much in every scene; it grows at once. */
const kShrink = 0.02;
/** How much slower or faster than the clock the time that is shown goes, when the delay has changed. */
const kSlower = 0.5;
const kFaster = 0.02;

/** Of a scene, what is another at every instant. */
export type Played = Pick<Scene, 'transforms' | 'background'>;

interface Kept extends Played {
  readonly captureMs: number;
  readonly moved: boolean;
}

/**
 * Objects where they were a little while ago, and the background as it was, between the scenes that say so, in every frame
 * of the display. By the clock of the engine; the page's is brought to it by the scene that came fastest, and the delay is as long as the others
 * are later and a scene lasts.
 */
export class Playout {
  #kept: Kept[] = [];
  /** The engine's clock less the page's, by scenes that came without delay. */
  #offsets: number[] = [];
  #delayMs = 0;
  #nowMs = 0;
  /** By the engine's clock; null: nothing has been shown yet. */
  #shown: number | null = null;

  add({ transforms, background }: Played, { captureMs, arrivedMs }: SceneTime): void {
    if (captureMs <= 0) {
      this.#kept = []; // nobody knows when it was
      return;
    }
    let last = this.#kept.at(-1);
    if (last && captureMs < last.captureMs) {
      this.#kept = []; // another engine, of another clock
      this.#offsets = [];
      this.#shown = null;
      last = undefined;
    }
    if (last && captureMs === last.captureMs) {
      this.#kept[this.#kept.length - 1] = { ...last, transforms, background }; // with objects of which rows have come since
      return;
    }
    this.#offsets.push(captureMs - arrivedMs);
    if (this.#offsets.length > 4 * kKept) this.#offsets.shift();
    const late = Math.max(...this.#offsets.slice(-kKept).map((offset) => this.#offset() - offset));
    const lasts = last && captureMs - last.captureMs < kGapMs ? captureMs - last.captureMs : 0;
    const needed = Math.min(late + lasts, kMostDelayMs);
    this.#delayMs = Math.max(needed, this.#delayMs + kShrink * (needed - this.#delayMs));
    const moved =
      last !== undefined &&
      (transforms.some((value, i) => value !== last.transforms[i]) || background.some((value, i) => value !== last.background[i]));
    this.#kept.push({ captureMs, transforms, background, moved });
    if (this.#kept.length > kKept) this.#kept.shift();
  }

  /** By the engine's clock: what is seen at `nowMs` of the page's, which goes forward. It never goes back, whatever the delay does. */
  shownMs(nowMs: number): number {
    const wanted = Math.min(nowMs + this.#offset() - this.#delayMs, this.#end());
    const step = Math.max(nowMs - this.#nowMs, 0);
    this.#nowMs = nowMs;
    if (this.#shown === null || Math.abs(wanted - this.#shown) > kGapMs) {
      this.#shown = wanted;
    } else {
      const next = this.#shown + clamp(wanted - this.#shown, (1 - kSlower) * step, (1 + kFaster) * step);
      this.#shown = Math.max(this.#shown, Math.min(next, this.#end()));
    }
    return this.#shown;
  }

  /** The same; null where nobody knows. */
  timeAt(nowMs: number): number | null {
    return this.#kept.length > 0 ? this.shownMs(nowMs) : null;
  }

  /** How long before `nowMs` that was what is shown then, but for the time that the scene that came fastest was under way; null where nobody knows. */
  ageMs(nowMs: number): number | null {
    return this.#kept.length > 0 ? nowMs + this.#offset() - this.shownMs(nowMs) : null;
  }

  /** Null where nothing is known, and the newest scene is to be shown. */
  at(nowMs: number): Played | null {
    const kept = this.#kept;
    const last = kept.at(-1);
    if (!last) return null;
    const shown = Math.min(this.shownMs(nowMs), this.#end());
    let next = kept.findIndex(({ captureMs }) => captureMs >= shown);
    if (next === 0) return kept[0];
    if (next < 0) next = kept.length - 1; // beyond the last: as between the two before
    const [from, to] = [kept[next - 1], kept[next]];
    if (!from || to.captureMs - from.captureMs > kGapMs) return shown >= to.captureMs || !from ? to : from;
    return between(from, to, (shown - from.captureMs) / (to.captureMs - from.captureMs));
  }

  /** Whether at() may give something else soon though no scene arrives. */
  movingAt(nowMs: number): boolean {
    const last = this.#kept.at(-1);
    return last !== undefined && last.moved && this.shownMs(nowMs) < this.#end();
  }

  #offset(): number {
    return Math.max(...this.#offsets);
  }

  /** A motion is known from two scenes on. */
  #end(): number {
    const last = this.#kept.at(-1);
    return last ? last.captureMs + (this.#kept.length > 1 ? kBeyondMs : 0) : Infinity;
  }
}

/** Beyond 1 objects go on along the same way, and the light, which cannot be less than none, does not. */
function between(from: Played, to: Played, part: number): Played {
  const [r, g, b] = [0, 1, 2].map((k) => mix(from.background[k], to.background[k], Math.min(part, 1)));
  return { transforms: transformsBetween(from.transforms, to.transforms, part), background: [r, g, b] };
}

/** Of what is hidden in one of the two, or not yet there, the later. */
function transformsBetween(from: Float32Array, to: Float32Array, part: number): Float32Array {
  const out = to.slice();
  for (let at = 0; at < to.length && at + kTransformFloats <= from.length; at += kTransformFloats) {
    const hidden = (of: Float32Array): boolean => of[at] === 0 && of[at + 1] === 0 && of[at + 2] === 0;
    if (hidden(from) || hidden(to)) continue;
    mixTransform(from, to, at, part, out);
  }
  return out;
}
