// A fixed flight, how long its frames took, and what drawing them costs.
import type { Pose } from './camera/rig';
import type { Stage } from './stage';
import { texts } from './texts';

const kWarmUp = 0.1; // of the flight

/** Milliseconds: half, 95 and 99 of 100 are shorter. */
export interface BenchFigures {
  readonly frames: number;
  readonly seconds: number;
  readonly framesPerSecond: number;
  readonly medianMs: number;
  readonly p95Ms: number;
  readonly p99Ms: number;
}

/** By the sum of all, which is right also where a browser's clock goes by whole milliseconds. */
function figuresOf(milliseconds: readonly number[]): BenchFigures {
  const sorted = [...milliseconds].sort((a, b) => a - b);
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

/** Once around a sphere, nearer and farther. */
class Flight {
  #began = 0;
  readonly #milliseconds: number[] = [];

  constructor(
    private readonly centre: readonly [number, number, number],
    private readonly radius: number,
    private readonly seconds: number,
  ) {}

  /** Where the camera is; null when the flight is over. It begins with the first call. */
  at(nowS: number): Pose | null {
    if (this.#began === 0) this.#began = nowS;
    const flown = nowS - this.#began;
    if (flown > this.seconds) return null;
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

  /** So much did a frame take, at the end of which it is `nowS`. */
  took(milliseconds: number, nowS: number): void {
    if (this.part(nowS) > kWarmUp) this.#milliseconds.push(milliseconds);
  }

  figures(): BenchFigures {
    return figuresOf(this.#milliseconds);
  }

  again(): Flight {
    return new Flight(this.centre, this.radius, this.seconds);
  }
}

interface BenchActions {
  /** Of the last picture, and of what it is of. */
  readonly told: () => object;
  /** Draws from there, and says whether that picture was there in the end. */
  readonly drawToEnd: (from: Pose) => Promise<boolean>;
}

/**
 * A flight that the address asked for, once all of the scene is there, and what was said of it. First it is flown as the
 * display goes, where everything that keeps up looks the same; then once more, one picture upon the other's end.
 */
export class BenchRun {
  #flight: Flight | null = null;
  /** As the display went, once that has been flown. */
  #paced: Flight | null = null;
  /** Of the last frame, in seconds; 0: there was none. */
  #last = 0;
  #resolutions = new Set<number>();
  #due = false;
  #text = '';

  constructor(
    private readonly seconds: number,
    public token: string | null,
    private readonly stage: Stage,
    private readonly actions: BenchActions,
  ) {
    this.asked = seconds > 0;
  }

  /** A flight is wanted, and has not begun. */
  asked: boolean;

  get flying(): boolean {
    return this.#flight !== null;
  }
  /** It draws by itself, and nobody else may. */
  get draws(): boolean {
    return this.#paced !== null;
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

  /** In every frame of the display: where the camera is; null when no flight goes by it. */
  at(nowS: number): Pose | null {
    const flight = this.#flight;
    if (!flight || this.draws) return null;
    const pose = flight.at(nowS);
    if (pose) {
      if (this.#last > 0) flight.took(1000 * (nowS - this.#last), nowS);
      this.#last = nowS;
    } else {
      void this.#flyAgain(flight);
    }
    return pose;
  }

  /** `missing`: pages that have not come. */
  text(missing: number): string {
    if (this.asked || this.#due) return texts.benchWaiting(missing);
    if (!this.#flight) return this.#text;
    const part = this.#flight.part(this.draws ? performance.now() / 1000 : this.#last);
    return texts.benchRunning((Number(this.draws) + part) / 2);
  }

  async #flyAgain(paced: Flight): Promise<void> {
    this.#paced = paced;
    const flight = (this.#flight = paced.again());
    for (let pose = flight.at(performance.now() / 1000); pose; pose = flight.at(performance.now() / 1000)) {
      const begun = performance.now();
      const counts = await this.actions.drawToEnd(pose).catch(() => false); // a device may be lost at any time
      const now = performance.now();
      if (counts) flight.took(now - begun, now / 1000);
      await nextTask();
    }
    this.#flight = this.#paced = null;
    await this.#report(paced.figures(), flight.figures());
  }

  async #report(figures: BenchFigures, drawing: BenchFigures): Promise<void> {
    const report = {
      ...figures,
      drawing,
      api: this.stage.renderer?.api ?? 'none',
      sortMs: this.stage.sortMs ?? 0,
      ...this.actions.told(),
      resolutions: [...this.#resolutions],
      browser: navigator.userAgent,
    };
    const posted = await postFigures(report, this.token);
    document.body.dataset.bench = JSON.stringify(report);
    this.#text = `${texts.benchDone(figures, drawing)} ${posted ? texts.benchPosted : texts.benchKept}`;
  }
}

/** The page hears, and shows, what came meanwhile. For a timer it would wait for milliseconds. */
function nextTask(): Promise<void> {
  const { port1, port2 } = new MessageChannel();
  return new Promise((resolve) => {
    port1.onmessage = () => {
      port1.close();
      resolve();
    };
    port2.postMessage(null);
  });
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
