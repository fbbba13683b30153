import { Backoff } from './backoff';

/** What has lived as long as this was started well: its end begins another count. */
const kHealthyMs = 10_000;

/** How long to wait before what has ended is started again; what ends soon after every start waits longer each time. */
export class Restarts {
  readonly #backoff: Backoff;
  #startedMs = Infinity;
  #inARow = 0;

  constructor(firstS: number, mostS: number) {
    this.#backoff = new Backoff(firstS, mostS);
  }

  started(nowMs: number): void {
    this.#startedMs = nowMs;
  }

  /** It has ended, or did not start. `well`: it had done what it is there for. Gives the seconds to wait. */
  ended(nowMs: number, well = nowMs - this.#startedMs >= kHealthyMs): number {
    if (well) this.reset();
    this.#startedMs = Infinity; // a start that fails next has not lived
    ++this.#inARow;
    return this.#backoff.seconds();
  }

  /** Ends since it was well. */
  get inARow(): number {
    return this.#inARow;
  }

  reset(): void {
    this.#backoff.reset();
    this.#inARow = 0;
  }
}
