import { texts } from '../texts';
import { make } from './dom';

type Key = keyof Omit<typeof texts.rows, 'atRest'>;

/** Figures over the picture. */
export class Overlay {
  readonly element = make('dl', { class: 'figures' });
  readonly #values = new Map<Key, HTMLElement>();

  /** Whether somebody wants it; null: nobody has said. */
  constructor(wanted: boolean | null) {
    this.element.hidden = wanted === null ? matchMedia('(max-width: 600px)').matches : !wanted; // on a phone they would be most of the picture
    const keys: Key[] = [
      'frames', 'frame', 'sort', 'gaussians', 'rate', 'roundTrip', 'age', 'missing', 'uploaded', 'resolution', 'drawnBy', 'connection',
    ];
    for (const key of keys) {
      const value = make('dd', { 'data-figure': key }, texts.unknown);
      this.#values.set(key, value);
      this.element.append(make('div', {}, make('dt', {}, texts.rows[key]), value));
    }
  }

  /** True if it is shown now. */
  toggle(): boolean {
    this.element.hidden = !this.element.hidden;
    return !this.element.hidden;
  }

  show(figures: Partial<Record<Key, string>>): void {
    for (const [key, text] of Object.entries(figures)) {
      const element = this.#values.get(key as Key);
      if (element && element.textContent !== text) element.textContent = text;
    }
  }
}

/** One line for what a person should know now; empty where there is nothing. */
export class Notice {
  readonly element = make('p', { class: 'notice', 'aria-hidden': 'true' });
  /** The same for who hears it, who would hear seconds that are counted and nothing else. */
  readonly spoken = make('p', { class: 'spoken', role: 'status' });
  #kept = '';
  #passing = 0;

  /** As long as nothing else is to be said. */
  keep(text: string): void {
    this.#kept = text;
    if (this.#passing === 0) this.#say(text);
  }
  /** For a few seconds. */
  pass(text: string): void {
    this.#say(text);
    clearTimeout(this.#passing);
    this.#passing = setTimeout(() => {
      this.#passing = 0;
      this.#say(this.#kept);
    }, 4000);
  }

  #say(text: string): void {
    if (this.element.textContent === text) return;
    const words = (of: string): string => of.replace(/[\d.,]+/g, '');
    if (words(this.spoken.textContent ?? '') !== words(text)) this.spoken.textContent = text;
    this.element.textContent = text;
  }
}
