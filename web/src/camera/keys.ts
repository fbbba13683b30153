import type { Motion } from './rig';

/** Turns a second, radians. */
export const kTurnSpeed = 1.2;

/** Keys that count by where they are: so they lie under the fingers on any layout. */
export const kMovingKeys: readonly string[] = ['KeyW', 'KeyA', 'KeyS', 'KeyD', 'KeyQ', 'KeyE'];
const kPlaces = new Set([
  ...kMovingKeys, 'ShiftLeft', 'ShiftRight', 'ArrowUp', 'ArrowDown', 'ArrowLeft', 'ArrowRight',
]);
/** Keys that count by what they say, for that is what a person looks for; what is on the same key without Shift, or with it. */
const kSigns = new Map([['+', 'nearer'], ['=', 'nearer'], ['-', 'farther'], ['_', 'farther']]);

export type Key = Pick<KeyboardEvent, 'code' | 'key'>;

/** Keys that are held down. */
export class HeldKeys {
  /** What they mean, by where they are: what one says may be another thing when it comes up. */
  readonly #down = new Map<string, string>();

  /** True if the key is one that moves the camera. */
  press({ code, key }: Key): boolean {
    const meaning = kPlaces.has(code) ? code : kSigns.get(key);
    if (meaning === undefined) return false;
    this.#down.set(code, meaning);
    return true;
  }
  /** macOS does not tell of keys that come up while Cmd is down. */
  release({ code, key }: Key): void {
    if (key === 'Meta') this.releaseAll();
    else this.#down.delete(code);
  }
  releaseAll(): void {
    this.#down.clear();
  }

  motion(): Motion {
    return {
      right: this.#axis('KeyD', 'KeyA'),
      up: this.#axis('KeyE', 'KeyQ'),
      ahead: this.#axis('KeyW', 'KeyS'),
      fast: this.#held('ShiftLeft') || this.#held('ShiftRight'),
    };
  }
  /** To the right and upwards, in [-1, 1]. */
  turn(): [number, number] {
    return [this.#axis('ArrowRight', 'ArrowLeft'), this.#axis('ArrowUp', 'ArrowDown')];
  }
  /** Nearer above 0. */
  zoom(): number {
    return this.#axis('nearer', 'farther');
  }

  #held(meaning: string): boolean {
    return [...this.#down.values()].includes(meaning);
  }
  #axis(more: string, less: string): number {
    return Number(this.#held(more)) - Number(this.#held(less));
  }
}
