import { Gamepads } from './gamepad';
import { HeldKeys, kTurnSpeed } from './keys';
import { Pointers } from './pointers';
import type { Rig } from './rig';
import { Stick } from './stick';
import { Wheel } from './wheel';

const kZoomASecond = 2.5;
const kLongestStepS = 0.1;

/** All that a person steers the camera with. */
export class Controls {
  readonly keys = new HeldKeys();
  readonly stick = new Stick();
  readonly #pads = new Gamepads();
  readonly #pointers: Pointers;
  onFrameAll: () => void = () => {};

  constructor(
    canvas: HTMLElement,
    private readonly rig: Rig,
  ) {
    this.#pointers = new Pointers(canvas, rig);
    new Wheel(canvas, rig);
    canvas.addEventListener('touched', () => (this.stick.element.hidden = false));
    addEventListener('blur', () => this.keys.releaseAll());
    document.addEventListener('visibilitychange', () => this.keys.releaseAll());
    addEventListener('keyup', (event) => this.keys.release(event));
  }

  /** As Pointers'. */
  set onPick(hear: (right: number, down: number) => void) {
    this.#pointers.onPick = hear;
  }

  /** Moves the camera by what has been held down for so long. */
  advance(seconds: number): void {
    const step = Math.min(seconds, kLongestStepS);
    this.#pointers.advance();
    const keys = this.keys.motion();
    const pad = this.#pads.read();
    const motion = {
      right: keys.right + this.stick.at[0] + (pad?.motion.right ?? 0),
      up: keys.up + (pad?.motion.up ?? 0),
      ahead: keys.ahead + this.stick.at[1] + (pad?.motion.ahead ?? 0),
      fast: keys.fast || (pad?.motion.fast ?? false),
    };
    if (motion.right !== 0 || motion.up !== 0 || motion.ahead !== 0) this.rig.fly(motion, step);
    const [right, up] = this.keys.turn();
    const turn = [right + (pad?.turn[0] ?? 0), up + (pad?.turn[1] ?? 0)] as const;
    if (turn[0] !== 0 || turn[1] !== 0) this.rig.look(turn[0] * kTurnSpeed * step, -turn[1] * kTurnSpeed * step);
    const zoom = this.keys.zoom();
    if (zoom !== 0) this.rig.zoom(kZoomASecond ** (-zoom * step));
    if (pad?.pressed) this.onFrameAll();
  }
}
