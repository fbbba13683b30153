/** Times between attempts: each half as long again as the one before, with a random part, so that not all come back at once. */
export class Backoff {
  #next: number;

  constructor(
    private readonly firstS: number,
    private readonly mostS: number,
  ) {
    this.#next = firstS;
  }

  seconds(): number {
    const wait = this.#next * (0.75 + 0.5 * Math.random());
    this.#next = Math.min(1.5 * this.#next, this.mostS);
    return wait;
  }

  /** It worked. */
  reset(): void {
    this.#next = this.firstS;
  }
}
