import type { Motion } from './rig';

const kDead = 0.12;

export interface PadState {
  readonly motion: Motion;
  /** To the right and upwards, in [-1, 1]. */
  readonly turn: readonly [number, number];
  /** The first button has just been pressed. */
  readonly pressed: boolean;
}

const beyondDead = (x: number): number => (Math.abs(x) < kDead ? 0 : (x - Math.sign(x) * kDead) / (1 - kDead));

/**
 * Every gamepad of the standard layout: left stick moves, right stick turns, triggers sink and rise, bumpers hurry. Of others
 * nobody knows what an axis is, or where it rests: a pedal at -1 would turn the camera for ever.
 */
export class Gamepads {
  #wasDown = false;

  read(): PadState | null {
    const pads = (navigator.getGamepads?.() ?? []).filter((pad) => pad?.connected && pad.mapping === 'standard');
    if (pads.length === 0) return null;
    const axis = (index: number): number => pads.reduce((sum, pad) => sum + beyondDead(pad?.axes[index] ?? 0), 0);
    const button = (index: number): number => Math.max(...pads.map((pad) => pad?.buttons[index]?.value ?? 0));
    const down = button(0) > 0.5;
    const pressed = down && !this.#wasDown;
    this.#wasDown = down;
    return {
      motion: { right: axis(0), ahead: -axis(1), up: button(7) - button(6), fast: button(4) + button(5) > 0.5 },
      turn: [axis(2), -axis(3)],
      pressed,
    };
  }
}
