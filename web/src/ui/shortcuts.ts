import { letterOf } from './keyboard';
import type { MenuActions } from './menu';

export interface ShortcutActions extends MenuActions {
  /** True if the key moves the camera. */
  readonly steer: (event: KeyboardEvent) => boolean;
  readonly menu: () => void;
  readonly escape: () => void;
}

/** What keys do besides moving the camera, by what they say. */
const kLetters: Readonly<Record<string, 'compare' | 'frameAll' | 'follow' | 'figures' | 'menu' | 'snapshot' | 'resetView' | 'fullScreen'>> = {
  c: 'compare',
  f: 'frameAll',
  g: 'follow',
  i: 'figures',
  m: 'menu',
  p: 'snapshot',
  r: 'resetView',
  v: 'fullScreen',
};

export function takeShortcuts(actions: ShortcutActions): void {
  addEventListener('keydown', (event) => {
    if (event.key === 'Escape') actions.escape();
    if (event.ctrlKey || event.metaKey || event.altKey || event.target instanceof HTMLSelectElement) return;
    if (event.target instanceof HTMLInputElement && event.code.startsWith('Arrow')) return;
    if (actions.steer(event)) {
      event.preventDefault();
      return;
    }
    const action = event.repeat ? undefined : kLetters[letterOf(event)];
    if (action) actions[action]();
  });
}
