import { length, mix, sub, type Vec3 } from './math';
import type { StreamFigures } from './stream/messages';

const kAgainMs = 500;
/** Of the way to a larger view, 1/e is left after this: nobody has asked for it, so it is to be seen coming. */
const kSmoothingS = 0.35;
/** Of the radius. */
const kNear = 1e-3;
const kAlike = 0.02;
/** How long bounds are waited for that stay: those of a world in which something large moves never do. */
const kSettlingMs = 4000;

interface Sphere {
  readonly centre: Vec3;
  readonly radius: number;
}

const apart = (a: Sphere, b: Sphere): number => length(sub(a.centre, b.centre)) + Math.abs(a.radius - b.radius);

/** Shows all that has come, again as more comes, until all of it is there or somebody steers. */
export class Framing {
  #ended = false;
  /** Since then no more comes, though some of it may be on its way to who knows the bounds. */
  #settledMs = Infinity;
  #asked = false;
  #askedMs = -Infinity;
  /** Gaussians that there were. */
  #askedOf = 0;
  /** The bounds that came last. */
  #last: Sphere | null = null;
  #shown: Sphere | null = null;
  #goal: Sphere | null = null;

  /** What is seen is as it is to be. */
  end(): void {
    this.#ended = true;
    this.#asked = false;
    this.#goal = null;
  }

  /** Whether to ask for the bounds of all; `settled`: no more comes. */
  asks({ gaussians }: StreamFigures, settled: boolean, nowMs: number): boolean {
    if (this.#ended || gaussians === 0 || nowMs - this.#askedMs < kAgainMs) return false;
    if (settled) this.#settledMs = Math.min(this.#settledMs, nowMs);
    this.#ended = nowMs - this.#settledMs >= kSettlingMs;
    if (this.#ended || (gaussians === this.#askedOf && this.#settledMs === Infinity)) return false;
    this.#asked = true;
    this.#askedMs = nowMs;
    this.#askedOf = gaussians;
    return true;
  }

  /** The bounds have come; false if it was somebody else who asked. */
  takes(centre: Vec3, radius: number): boolean {
    if (!this.#asked) return false;
    this.#asked = false;
    const next = { centre, radius };
    this.#ended ||= this.#settledMs < Infinity && this.#last !== null && apart(this.#last, next) < kAlike * radius;
    this.#goal = this.#last = next;
    return true;
  }

  /** What is to be framed now; null: what is framed already. */
  advance(seconds: number): Sphere | null {
    const to = this.#goal;
    if (!to) return null;
    const from = this.#shown ?? to;
    const part = 1 - Math.exp(-seconds / kSmoothingS);
    const [x, y, z] = [0, 1, 2].map((k) => mix(from.centre[k], to.centre[k], part));
    const next: Sphere = { centre: [x, y, z], radius: from.radius * (to.radius / from.radius) ** part };
    this.#shown = apart(next, to) < kNear * to.radius ? to : next;
    if (this.#shown === to) this.#goal = null;
    return this.#shown;
  }
}
