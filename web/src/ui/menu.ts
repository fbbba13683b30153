import { kModelFiles, type ModelFile } from '../download';
import { texts } from '../texts';
import { button, choice, make } from './dom';
import { layoutHere, namesOfKeys, type Layout } from './keyboard';
import { kGaussianBudgets, kRateBudgets, type Settings } from './settings';
import { nameOfShortcut } from './shortcut_keys';

export interface MenuActions {
  readonly frameAll: () => void;
  readonly resetView: () => void;
  readonly fullScreen: () => void;
  readonly snapshot: () => void;
  readonly share: () => void;
  readonly figures: () => void;
  readonly compare: () => void;
  /** Goes along with the engine's player, or no more. */
  readonly follow: () => void;
  readonly immerse: () => void;
  readonly download: (kind: ModelFile) => void;
  /** `settings` have changed. */
  readonly changed: () => void;
}

/** What is on now, and whether there is a player to go along with. */
export interface MenuState {
  readonly player: boolean;
  readonly following: boolean;
  readonly figures: boolean;
  readonly comparing: boolean;
}

/** A dialog that leaves the picture usable. */
export class Menu {
  readonly element: HTMLDialogElement;
  readonly opener = button(texts.menu, () => this.toggle());
  readonly #figures: HTMLButtonElement;
  readonly #compare: HTMLButtonElement;
  readonly #follow: HTMLButtonElement;
  readonly #immerse: HTMLButtonElement;
  /** What says names of keys that are not the same on every keyboard. */
  readonly #names = new Map<HTMLElement, (layout: Layout | null) => string>();

  constructor(settings: Settings, actions: MenuActions) {
    this.#figures = button(texts.figures, actions.figures);
    this.#compare = button(texts.compare, actions.compare);
    this.#follow = button(texts.follow, actions.follow);
    this.#follow.hidden = true;
    this.#immerse = button(texts.immerse, actions.immerse);
    this.#immerse.hidden = true;
    const fullScreen = button(texts.fullScreen, actions.fullScreen);
    fullScreen.hidden = !document.fullscreenEnabled;
    const budgets = Object.fromEntries(kGaussianBudgets.map((value) => [String(value), texts.count(value)]));
    const rates = Object.fromEntries(kRateBudgets.map((value) => [String(value), value === 0 ? texts.noLimit : String(value)]));
    const change = (apply: () => void) => (): void => {
      apply();
      actions.changed();
    };
    this.element = make(
      'dialog',
      { class: 'menu', 'aria-label': texts.menu },
      make(
        'div',
        { class: 'buttons actions' },
        button(texts.frameAll, actions.frameAll),
        button(texts.resetView, actions.resetView),
        fullScreen,
        button(texts.snapshot, actions.snapshot),
        button(texts.share, actions.share),
        this.#figures,
        this.#compare,
        this.#follow,
        this.#immerse,
      ),
      choice(texts.quality, texts.qualities, settings.quality, (key) => change(() => (settings.quality = key))()),
      choice(texts.gaussianBudget, budgets, String(settings.budget.gaussians), (key) =>
        change(() => (settings.budget = { ...settings.budget, gaussians: Number(key) }))(),
      ),
      choice(texts.rateBudget, rates, String(settings.budget.megabits), (key) =>
        change(() => (settings.budget = { ...settings.budget, megabits: Number(key) }))(),
      ),
      choice(texts.background, texts.backgrounds, settings.background, (key) => change(() => (settings.background = key))()),
      choice(texts.speed, texts.speeds, settings.speed, (key) => change(() => (settings.speed = key))()),
      make('h2', {}, texts.download),
      make('div', { class: 'buttons' }, ...kModelFiles.map((kind) => button(`.${kind}`, () => actions.download(kind)))),
      make('h2', {}, texts.keys),
      make('dl', { class: 'keys' }, ...texts.keyList.map(([key, what]) => make('div', {}, this.#keyName(key), make('dd', {}, what)))),
      button(texts.close, () => this.element.close()),
    );
    const say = (): void => this.opener.setAttribute('aria-expanded', String(this.element.open));
    new MutationObserver(say).observe(this.element, { attributeFilter: ['open'] });
    say();
  }

  #keyName(key: string | readonly string[]): HTMLElement {
    const element = make('dt');
    if (typeof key !== 'string') this.#names.set(element, (layout) => namesOfKeys(key, layout));
    else if (key.length === 1) this.#names.set(element, (layout) => nameOfShortcut(key, layout));
    else element.textContent = key;
    return element;
  }

  /** There is a headset. */
  offerImmersion(): void {
    this.#immerse.hidden = false;
  }

  show(state: MenuState): void {
    this.#follow.hidden = !state.player;
    this.#follow.setAttribute('aria-pressed', String(state.following));
    this.#figures.setAttribute('aria-pressed', String(state.figures));
    this.#compare.setAttribute('aria-pressed', String(state.comparing));
  }

  toggle(): void {
    if (this.element.open) return this.element.close();
    // Each time: a person may have another keyboard by now.
    void layoutHere().then((layout) => {
      for (const [element, name] of this.#names) element.textContent = name(layout);
    });
    this.element.show();
  }
}
