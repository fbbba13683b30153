import { scaledView, type View } from '../math';
import type { Picture } from '../render/renderer';
import type { EnginePicture } from '../stream/messages';
import { texts } from '../texts';
import { make } from '../ui/dom';
import type { Pair, PairQuality } from './metrics_worker';

/** Of the engine's picture, the longer side: it is the engine that has to draw it. */
const kMostPixels = 768;
/** A scene that lives is compared again after this. */
const kAgainMs = 2000;
const kPatienceMs = 8000;

export interface ComparisonActions {
  /** Asks the engine for its own picture from there. */
  readonly ask: (probeId: number, view: View) => void;
  /** What the splats look like from there with objects so; null while nothing can be drawn. */
  readonly capture: (view: View, transforms: Float32Array) => Promise<Picture | null>;
  readonly notice: (text: string) => void;
}

const sameView = (a: View, b: View): boolean =>
  a.width === b.width && a.height === b.height && a.fx === b.fx && a.viewFromWorld.every((value, i) => value === b.viewFromWorld[i]);

/** Of the size that the engine is asked for, in whole pixels. */
function askedView(view: View): View {
  const part = Math.min(1, kMostPixels / Math.max(view.width, view.height));
  return scaledView(view, Math.max(16, Math.round(view.width * part)), Math.max(16, Math.round(view.height * part)));
}

/** The engine's own picture beside the splats, with a slider between them and how far they differ. */
export class Comparison {
  readonly element: HTMLElement;
  readonly slider = make('input', { type: 'range', min: '0', max: '100', value: '50', 'aria-label': texts.compareSlider });
  readonly #picture = make('canvas');
  readonly #figures = make('p', { class: 'quality', role: 'status' });
  #worker: Worker | null = null;
  #asked: { id: number; view: View; atMs: number } | null = null;
  #shown: { id: number; view: View; atMs: number } | null = null;
  /** Before this the engine is not asked again. */
  #notBeforeMs = 0;
  /** The pair that the worker is at, so that on a slow machine one is measured before the next takes its place. */
  #measuring: number | null = null;
  /** Of the picture that is shown. */
  quality: PairQuality | null = null;

  constructor(private readonly actions: ComparisonActions) {
    const side = (text: string, name: string): HTMLElement => make('span', { class: `side ${name}` }, text);
    this.element = make(
      'div',
      { class: 'compare', hidden: '' },
      make('div', { class: 'engine' }, this.#picture),
      make('div', { class: 'line' }),
      side(texts.splats, 'left'),
      side(texts.engine, 'right'),
      this.#figures,
      this.slider,
    );
    const move = (): void => this.element.style.setProperty('--part', String(Number(this.slider.value) / 100));
    this.slider.addEventListener('input', move);
    move();
  }

  get on(): boolean {
    return !this.element.hidden;
  }

  toggle(): void {
    this.element.hidden = this.on;
    this.#asked = this.#shown = this.quality = this.#measuring = null;
    this.#show(false);
    this.#figures.textContent = this.on ? texts.comparing : '';
    this.#worker?.terminate();
    this.#worker = null;
    if (this.on) this.slider.focus();
  }

  /** Nothing is called the engine's that is not. */
  #show(picture: boolean): void {
    this.#picture.hidden = !picture;
    this.element.classList.toggle('empty', !picture);
  }

  /** To be called with every frame; `resting`: the camera has come to rest, and what is drawn is of this view. */
  advance(nowMs: number, view: View, resting: boolean): void {
    if (!this.on) return;
    const wanted = askedView(view);
    if (this.#shown && !sameView(this.#shown.view, wanted)) {
      this.#shown = this.quality = this.#measuring = null;
      this.#show(false);
      this.#figures.textContent = texts.comparing;
    }
    if (this.#asked && nowMs - this.#asked.atMs > kPatienceMs) {
      this.#asked = null;
      this.actions.notice(texts.compareUnanswered);
    }
    const due = !this.#shown || nowMs - this.#shown.atMs > kAgainMs;
    if (!resting || this.#asked || this.#measuring !== null || !due || nowMs < this.#notBeforeMs) return;
    const id = Math.floor(Math.random() * Number.MAX_SAFE_INTEGER);
    this.#asked = { id, view: wanted, atMs: nowMs };
    this.actions.ask(id, wanted);
  }

  /** The engine's answer. */
  async hear(answer: EnginePicture): Promise<void> {
    const asked = this.#asked;
    if (!this.on || asked?.id !== answer.probeId) return;
    const splats = await this.actions.capture(asked.view, answer.transforms).catch(() => null); // a device may be lost at any time
    if (this.#asked !== asked) return; // switched off meanwhile
    this.#asked = null;
    if (!splats || splats.width !== answer.width || splats.height !== answer.height) {
      this.#notBeforeMs = performance.now() + kAgainMs;
      return;
    }
    this.#shown = { id: asked.id, view: asked.view, atMs: performance.now() };
    this.#picture.width = answer.width;
    this.#picture.height = answer.height;
    this.#picture.getContext('2d')?.putImageData(new ImageData(answer.rgba, answer.width, answer.height), 0, 0);
    this.#show(true);
    const pair: Pair = { id: asked.id, width: answer.width, height: answer.height, picture: splats.rgba, reference: answer.rgba };
    this.#metrics().postMessage(pair, [pair.picture.buffer, pair.reference.buffer]);
    this.#measuring = asked.id;
  }

  #metrics(): Worker {
    if (this.#worker) return this.#worker;
    const worker = new Worker('metrics_worker.js', { type: 'module', name: 'metrics' });
    this.#worker = worker;
    worker.onmessage = ({ data }: MessageEvent<PairQuality>) => {
      if (data.id !== this.#shown?.id) return;
      this.#measuring = null;
      this.quality = data;
      this.#figures.textContent = texts.likeness(data.ssim, data.flip);
    };
    worker.onerror = ({ message }) => {
      if (this.#worker !== worker) return;
      console.warn(`pictures are not compared: ${message}`);
      worker.terminate();
      this.#worker = null; // the next pair has another
      this.quality = this.#measuring = null;
      this.#figures.textContent = texts.compareUnmeasured;
    };
    return worker;
  }
}
