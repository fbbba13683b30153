// Which keys the shortcuts are on this keyboard. A letter counts by what its key says; on a layout that has one of them where
// movement has its keys (Colemak's F and R, BÉPO's P and I) all count by where they are on an English keyboard instead.
import { kMovingKeys, type Key } from '../camera/keys';
import { capitalOf, latinOf, letterOf, type Layout } from './keyboard';

/** What keys do besides moving the camera. */
export const kShortcuts: Readonly<Record<string, 'compare' | 'frameAll' | 'follow' | 'figures' | 'menu' | 'snapshot' | 'resetView' | 'fullScreen'>> = {
  c: 'compare',
  f: 'frameAll',
  g: 'follow',
  i: 'figures',
  m: 'menu',
  p: 'snapshot',
  r: 'resetView',
  v: 'fullScreen',
};

const saysShortcut = (letter: string): boolean => letter in kShortcuts;

/** What a shortcut's key is called there, as 'F'. */
export function nameOfShortcut(letter: string, layout: Layout | null): string {
  const clashes = layout && kMovingKeys.some((code) => saysShortcut(layout.get(code) ?? ''));
  return clashes ? capitalOf(layout.get(`Key${letter}`) ?? letter) : letter;
}

/** Learns the keyboard from what the browser tells of it, and from what is pressed: not every browser tells. */
export class ShortcutKeys {
  /** What keys say that move, by where they are. */
  readonly #said = new Map<string, string>();

  learn(layout: Layout | null): void {
    for (const code of layout ? kMovingKeys : []) this.#said.set(code, layout?.get(code) ?? '');
  }

  /** The shortcut that a key is, as 'f'; '' for none. Every key that goes down is to be told. */
  letterOf(key: Key): string {
    if (kMovingKeys.includes(key.code)) {
      this.#said.set(key.code, letterOf(key));
      return '';
    }
    const letter = [...this.#said.values()].some(saysShortcut) ? latinOf(key.code) : letterOf(key);
    return saysShortcut(letter) ? letter : '';
  }
}
