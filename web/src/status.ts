import { rightsHere } from './download';
import { Rate, type Pace } from './pace';
import type { Stage } from './stage';
import type { ConnectionState, FromStreamWorker, StreamFigures } from './stream/messages';
import { texts } from './texts';
import { Notice, Overlay } from './ui/overlay';
import { keepSettings, type Settings } from './ui/settings';

const kEveryMs = 250;

/** What the page says of the stream and of its pictures: figures, and one line of what a person should know. */
export class Status {
  readonly overlay: Overlay;
  readonly notice = new Notice();
  readonly #rate = new Rate();
  /** The last that the stream's worker said. */
  figures: StreamFigures | null = null;
  connection: ConnectionState = 'connecting';
  /** What is wrong with what draws. */
  graphics = '';
  #retryAtMs = 0;
  /** The stream's worker has died, and what it was to hold at most: of memory until there is all, while it is tried again too. */
  #died: { outOfMemory: boolean; budget: number } | null = null;
  /** Why the server lets nobody in; empty where it does, or is not there. */
  #refused = '';
  #shownMs = 0;

  constructor(
    private readonly stage: Stage,
    private readonly pace: Pace,
    private readonly access: { readonly token: string | null },
    private readonly settings: Settings,
  ) {
    this.overlay = new Overlay(settings.figures);
  }

  toggleFigures(): void {
    this.settings.figures = this.overlay.toggle();
    keepSettings(this.settings);
  }

  /** `settled`: there is all of the model that is to come. */
  hear(message: FromStreamWorker, settled: boolean): void {
    if (message.kind === 'figures') {
      if (message.figures.missing === 0 && this.figures?.missing !== 0) this.#shownMs = -Infinity;
      if (settled) this.#died = null;
      this.figures = message.figures;
      this.#rate.add(message.figures.atMs, message.figures.bytes);
    } else if (message.kind === 'connection') {
      this.connection = message.state;
      this.#shownMs = -Infinity;
      this.#retryAtMs = message.state === 'waiting' ? performance.now() + 1000 * message.retryS : 0;
      if (message.died) this.#mourn(message.died === 'out of memory');
      else if (message.state === 'waiting') void this.#askWhy();
      if (message.state === 'open') this.#refused = '';
      if (message.state === 'open' && !this.#died?.outOfMemory) this.#died = null;
    }
  }

  #mourn(outOfMemory: boolean): void {
    this.#died = { outOfMemory, budget: this.settings.budget.gaussians };
    if (!outOfMemory) this.notice.pass(texts.workerLost);
  }

  /**
   * To be called with every turn of the display; true if it was time to. `resolution`: of what was drawn last; `doing`: what
   * the page is about.
   */
  show(nowMs: number, resolution: number, doing: string): boolean {
    if (nowMs - this.#shownMs <= kEveryMs) return false;
    this.#shownMs = nowMs;
    const { figures, stage, pace } = this;
    const known = (value: number | undefined, show: (value: number) => string): string =>
      value === undefined || value < 0 ? texts.unknown : show(value);
    const moving = pace.frameMs > 0 && !pace.restsAt(nowMs);
    const connection = this.connection === 'open' ? texts.connected : texts.connecting;
    const waiting = Math.max(0, (this.#retryAtMs - nowMs) / 1000);
    this.overlay.show({
      frames: moving ? pace.framesPerSecond.toFixed(0) : texts.rows.atRest,
      frame: moving ? texts.ms(pace.frameMs) : texts.unknown,
      sort: stage.sortMs === null ? texts.unknown : texts.ms(stage.sortMs),
      gaussians: known(figures?.gaussians, (n) => n.toLocaleString('en')),
      rate: texts.rate(this.#rate.megabits, this.settings.budget.megabits),
      roundTrip: known(figures?.roundTripMs, texts.ms),
      age: known(this.#ageMs(nowMs), texts.ms),
      missing: known(figures?.missing, texts.pages),
      uploaded: stage.uploadedRows.toLocaleString('en'),
      resolution: resolution > 0 ? texts.percent(resolution) : texts.unknown,
      drawnBy: stage.renderer ? texts.apis[stage.renderer.api] : texts.unknown,
      connection: this.#retryAtMs > 0 ? texts.lost : connection,
    });
    const problem =
      this.graphics ||
      (this.#died?.outOfMemory ? texts.tooLarge(waiting) : '') ||
      (this.#retryAtMs > 0 ? this.#refused || (this.#died ? texts.workerLost : texts.reconnecting(waiting)) : '') ||
      doing ||
      (stage.standing ? '' : this.connection === 'open' ? texts.waitingForScene : texts.connecting);
    this.notice.keep(problem);
    return true;
  }

  /** Somebody has chosen: fewer may fit, as many as before would not. */
  askedFor(gaussians: number): void {
    if (this.#died?.outOfMemory && gaussians < this.#died.budget) this.#died = null;
  }

  /** Where nobody knows the engine's clock, since the last scene came: see Playout. */
  #ageMs(nowMs: number): number | undefined {
    const shown = this.stage.ageMs(nowMs);
    return shown === null ? this.figures?.ageMs : shown + Math.max(0, this.figures?.roundTripMs ?? 0) / 2;
  }

  /** A WebSocket does not say why it was not opened. */
  async #askWhy(): Promise<void> {
    const { token } = this.access;
    const here = await rightsHere(token);
    if (token !== this.access.token) return; // somebody has another one now
    const refused = token ? texts.tokenRefused : texts.tokenMissing;
    this.#refused = here === 'refused' ? refused : '';
  }
}
