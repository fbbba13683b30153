import type { Motion } from './rig';

/** Turns a second, radians. */
export const kTurnSpeed = 1.2;

const kHeld = new Set([
  'KeyW', 'KeyA', 'KeyS', 'KeyD', 'KeyQ', 'KeyE', 'ShiftLeft', 'ShiftRight',
  'ArrowUp', 'ArrowDown', 'ArrowLeft', 'ArrowRight', 'Equal', 'Minus', 'NumpadAdd', 'NumpadSubtract',
]);

/** Keys that are held down, by where they are and not by what they say. */
export class HeldKeys {
  readonly #down = new Set<string>();

  /** True if the key is one that moves the camera. */
  press(code: string): boolean {
    if (!kHeld.has(code)) return false;
    this.#down.add(code);
    return true;
  }
  release(code: string): void {
    this.#down.delete(code);
  }
  releaseAll(): void {
    this.#down.clear();
  }

  motion(): Motion {
    return {
      right: this.#axis('KeyD', 'KeyA'),
      up: this.#axis('KeyE', 'KeyQ'),
      ahead: this.#axis('KeyW', 'KeyS'),
      fast: this.#down.has('ShiftLeft') || this.#down.has('ShiftRight'),
    };
  }
  /** To the right and upwards, in [-1, 1]. */
  turn(): [number, number] {
    return [this.#axis('ArrowRight', 'ArrowLeft'), this.#axis('ArrowUp', 'ArrowDown')];
  }
  /** Nearer above 0. */
  zoom(): number {
    return this.#axis('Equal', 'Minus') + this.#axis('NumpadAdd', 'NumpadSubtract');
  }

  #axis(more: string, less: string): number {
    return Number(this.#down.has(more)) - Number(this.#down.has(less));
  }
}
