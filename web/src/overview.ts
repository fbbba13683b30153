import type { Pose, Rig } from './camera/rig';
import { Framing } from './framing';
import type { Vec3 } from './math';
import type { Stage } from './stage';
import type { StreamFigures } from './stream/messages';
import type { StreamLink } from './stream/stream_link';

/** Has the camera show all: of its own accord while the model comes, and when somebody asks. */
export class Overview {
  readonly #framing = new Framing();
  /** What the page was opened with, or showed first. */
  #firstView: Pose | null = null;

  constructor(
    private readonly stage: Stage,
    private readonly rig: Rig,
    private readonly link: StreamLink,
  ) {}

  /** The camera is where the address says: nothing else is shown of its own accord. */
  keepView(): void {
    this.end();
    this.#firstView = this.rig.goal;
  }

  /** Nothing is shown any more that nobody asks for. */
  end(): void {
    this.#framing.end();
  }

  /** To show all: the bounds of it come. */
  ask(): void {
    this.link.send({ kind: 'bounds' });
  }

  /** Back to the first view. */
  reset(): void {
    if (this.#firstView) this.rig.moveStraight(this.#firstView);
    else this.ask();
  }

  /** So much has come; `settled`: no more does. True if that is to be shown, and was asked for. */
  hear(figures: StreamFigures, settled: boolean): boolean {
    const asks = this.#framing.asks(figures, settled, performance.now());
    if (asks) this.ask();
    return asks;
  }

  /** The bounds of all. True if it was somebody who asked: the camera goes there at once. */
  show(centre: Vec3, radius: number): boolean {
    if (this.#framing.takes(centre, radius)) return false;
    this.#frame(centre, radius);
    return true;
  }

  /** Comes nearer to what came, with every turn of the display. */
  advance(seconds: number): void {
    const sphere = this.#framing.advance(this.rig.smooth ? seconds : Infinity);
    if (!sphere) return;
    this.#frame(sphere.centre, sphere.radius);
    this.#firstView = this.rig.goal;
  }

  #frame(centre: Vec3, radius: number): void {
    const { clientWidth, clientHeight } = this.stage.element;
    this.rig.frame(centre, radius, clientWidth, clientHeight);
    if (!this.stage.standing) this.rig.jump(this.rig.goal);
  }
}
