// A fixed flight, and how long its frames took.
import type { Pose } from './camera/rig';
import { texts } from './texts';

const kWarmUp = 0.1; // of the flight

interface BenchFigures {
  readonly frames: number;
  readonly seconds: number;
  readonly framesPerSecond: number;
  /** Between pictures, milliseconds: half, 95 and 99 of 100 are shorter. */
  readonly medianMs: number;
  readonly p95Ms: number;
  readonly p99Ms: number;
}

/** Once around a sphere, nearer and farther. */
class Flight {
  #began = 0;
  #intervals: number[] = [];
  #last = 0;

  constructor(
    private readonly centre: readonly [number, number, number],
    private readonly radius: number,
    private readonly seconds: number,
  ) {}

  /** Where the camera is; null when the flight is over. */
  at(nowS: number): Pose | null {
    if (this.#began === 0) this.#began = nowS;
    const flown = nowS - this.#began;
    if (flown > this.seconds) return null;
    if (flown > kWarmUp * this.seconds && this.#last > 0) this.#intervals.push(1000 * (nowS - this.#last));
    this.#last = nowS;
    const turn = (2 * Math.PI * flown) / this.seconds;
    return {
      target: this.centre,
      yaw: turn,
      pitch: 0.35 + 0.2 * Math.sin(2 * turn),
      distance: this.radius * (1.4 + 0.9 * Math.cos(turn)),
    };
  }

  part(nowS: number): number {
    return Math.min((nowS - this.#began) / this.seconds, 1);
  }

  figures(): BenchFigures {
    const sorted = [...this.#intervals].sort((a, b) => a - b);
    const at = (part: number): number => sorted[Math.min(Math.floor(part * sorted.length), sorted.length - 1)] ?? 0;
    const seconds = sorted.reduce((sum, ms) => sum + ms, 0) / 1000;
    return {
      frames: sorted.length,
      seconds,
      framesPerSecond: seconds > 0 ? sorted.length / seconds : 0,
      medianMs: at(0.5),
      p95Ms: at(0.95),
      p99Ms: at(0.99),
    };
  }
}

/** A flight that the address asked for, once all of the scene is there, and what was said of it. */
export class BenchRun {
  #flight: Flight | null = null;
  #resolutions = new Set<number>();
  #due = false;
  #text = '';

  constructor(
    private readonly seconds: number,
    private readonly token: string | null,
  ) {
    this.asked = seconds > 0;
  }

  /** A flight is wanted, and has not begun. */
  asked: boolean;

  get flying(): boolean {
    return this.#flight !== null;
  }

  /** What it flies around is asked for. */
  prepare(): void {
    this.#due = this.asked;
    this.asked = false;
  }
  around(centre: readonly [number, number, number], radius: number): void {
    if (this.#due) this.#flight = new Flight(centre, radius, this.seconds);
    this.#due = false;
  }

  /** A picture of the splats' own target so fine. */
  drawn(resolution: number): void {
    if (this.#flight) this.#resolutions.add(resolution);
  }

  /** Where the camera is; null when no flight is under way. `told` is what is reported with the figures of one that ends. */
  at(nowS: number, told: () => object): Pose | null {
    const flown = this.#flight;
    const pose = flown?.at(nowS) ?? null;
    if (!flown || pose) return pose;
    this.#flight = null;
    void this.#report({ ...flown.figures(), ...told(), resolutions: [...this.#resolutions] }, flown.figures());
    return null;
  }

  /** `missing`: pages that have not come. */
  text(nowS: number, missing: number): string {
    if (this.asked || this.#due) return texts.benchWaiting(missing);
    return this.#flight ? texts.benchRunning(this.#flight.part(nowS)) : this.#text;
  }

  async #report(report: object, figures: BenchFigures): Promise<void> {
    const posted = await postFigures(report, this.token);
    document.body.dataset.bench = JSON.stringify(report);
    this.#text = `${texts.benchDone(figures.framesPerSecond, figures.medianMs)} ${posted ? texts.benchPosted : texts.benchKept}`;
  }
}

/** True if the server took them. */
async function postFigures(figures: object, token: string | null): Promise<boolean> {
  try {
    const answer = await fetch('bench', {
      method: 'POST',
      headers: { 'content-type': 'application/json', ...(token ? { authorization: `Bearer ${token}` } : {}) },
      body: JSON.stringify(figures),
    });
    return answer.ok;
  } catch {
    return false;
  }
}
