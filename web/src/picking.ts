import type { Pose, Rig } from './camera/rig';
import type { Vec3, View } from './math';
import type { Stage } from './stage';
import type { StreamLink } from './stream/stream_link';

/** Brings what somebody points at to the middle, and has the camera orbit the surface there. */
export class Picking {
  #number = 0;
  /** Where the camera was to go when it was last asked. */
  #goal: Pose | null = null;

  constructor(
    private readonly stage: Stage,
    private readonly rig: Rig,
    private readonly link: StreamLink,
    private readonly view: () => View,
    private readonly mip: boolean,
  ) {}

  /**
   * In focal lengths off the middle. It comes there at once, and how far it is when the stream's worker has found out: at the
   * distance of before where nothing is hit, or nobody answers.
   */
  at(right: number, down: number): void {
    const view = this.view();
    const [x, y] = [view.cx + right * view.fx, view.cy + down * view.fy];
    const scene = this.stage.sceneAt(performance.now());
    this.rig.centre(right, down);
    this.#goal = this.rig.goal;
    this.link.send({ kind: 'pick', number: ++this.#number, at: { view, x, y, scene, mip: this.mip } });
  }

  /** What was found. Who steers meanwhile is not taken elsewhere. */
  hear(number: number, point: Vec3 | null): void {
    if (point && number === this.#number && this.rig.goal === this.#goal) this.rig.orbitAbout(point);
  }
}
