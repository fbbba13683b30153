const kMostMs = 300;
const kMostPixels = 24;

interface Tap {
  readonly x: number;
  readonly y: number;
  readonly ms: number;
}

const follows = (before: Tap, after: Tap): boolean =>
  after.ms - before.ms < kMostMs && Math.hypot(after.x - before.x, after.y - before.y) < kMostPixels;

/** Tells two taps at one place from all else that pointers do. Browsers do so for a mouse alone: not every one has a `dblclick` of fingers. */
export class Taps {
  #pressed: Tap | null = null;
  #before: Tap | null = null;

  press(at: Tap): void {
    this.#pressed = at;
  }

  /** What is down is no tap. */
  cancel(): void {
    this.#pressed = this.#before = null;
  }

  /** True with the second of two. */
  release(at: Tap): boolean {
    const pressed = this.#pressed;
    const before = this.#before;
    this.cancel();
    if (!pressed || !follows(pressed, at)) return false;
    if (before && follows(before, pressed)) return true;
    this.#before = at;
    return false;
  }
}
