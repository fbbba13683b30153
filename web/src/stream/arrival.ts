import type { StreamFigures } from './messages';

/** Longer than the next page takes on a slow connection. */
const kQuietMs = 5000;

/** Whether of the model has come what is to come: of a world beyond the budget the rest never does. */
export class Arrival {
  #epoch = -1;
  #least = Infinity;
  #newsMs = 0;

  /** `open`: there is a connection by which more may come. */
  settled({ epoch, gaussians, missing }: StreamFigures, open: boolean, nowMs: number): boolean {
    if (!open || epoch !== this.#epoch) this.#least = Infinity;
    this.#epoch = epoch;
    const knows = open && gaussians > 0 && missing >= 0;
    if (!knows || missing < this.#least) this.#newsMs = nowMs;
    if (knows) this.#least = Math.min(this.#least, missing);
    return knows && (missing === 0 || nowMs - this.#newsMs >= kQuietMs);
  }
}
