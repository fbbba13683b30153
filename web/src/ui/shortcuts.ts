import { layoutHere } from './keyboard';
import type { MenuActions } from './menu';
import { kShortcuts, ShortcutKeys } from './shortcut_keys';

export interface ShortcutActions extends MenuActions {
  /** True if the key moves the camera. */
  readonly steer: (event: KeyboardEvent) => boolean;
  readonly menu: () => void;
  readonly escape: () => void;
}

export function takeShortcuts(actions: ShortcutActions): void {
  const keys = new ShortcutKeys();
  const look = (): void => void layoutHere().then((layout) => keys.learn(layout));
  look();
  addEventListener('focus', look); // another keyboard, perhaps
  addEventListener('keydown', (event) => {
    if (event.key === 'Escape') actions.escape();
    if (event.ctrlKey || event.metaKey || event.altKey || event.target instanceof HTMLSelectElement) return;
    if (event.target instanceof HTMLInputElement && event.code.startsWith('Arrow')) return;
    const letter = keys.letterOf(event);
    if (actions.steer(event)) {
      event.preventDefault();
      return;
    }
    const action = event.repeat ? undefined : kShortcuts[letter];
    if (action) actions[action]();
  });
}
