import { ColorPlayout } from './motion/color_playout';
import { Playout } from './motion/playout';
import { giveUpWebGpu, makeRenderer, type Api } from './render/make_renderer';
import { kNoScene, type Scene } from './records';
import { kFadeS, type EyeRenderer, type Frame, type Picture, type Renderer } from './render/renderer';
import { Restarts } from './restarts';
import { Still } from './still';
import type { SceneBatch, Sorted, ToSortWorker } from './stream/messages';
import { make } from './ui/dom';

/** Devices of WebGPU that are lost one soon after the other. */
const kMostLosses = 3;

const isForHeadset = (renderer: Renderer | null): renderer is EyeRenderer => renderer !== null && (renderer as EyeRenderer).forHeadset === true;

/**
 * What draws, and what it is fed by. A device or a sorter that is lost is replaced, and everything asked for again; until
 * the new one has something to show, a still of the last picture stands.
 */
export class Stage {
  readonly element = make('div', { class: 'stage', tabindex: '0', role: 'application' });
  readonly #still = new Still();
  readonly #devices = new Restarts(0.25, 8);
  readonly #sorters = new Restarts(0.25, 8);
  #startsAgain: ReturnType<typeof setTimeout> | undefined;
  #feedsAgain: ReturnType<typeof setTimeout> | undefined;
  /** Of starts: what an earlier one still makes is not wanted any more. */
  #newest = 0;
  #canvas = make('canvas');
  #renderer: Renderer | null = null;
  /** A headset is drawn for, and what drew before it. */
  #lent: { before: Api | null } | null = null;
  /** The renderer has rows: before that it would draw a background alone. */
  #fed = false;
  /** Where batches come from, if not from the sorter. */
  #source: MessagePort | null = null;
  #sorter: Worker | null = null;
  #sorting = false;
  #view: Float64Array | null = null;
  #viewDue = false;
  #batches: SceneBatch[] = [];
  #order: Uint32Array | null = null;
  #uploadedBefore = 0;
  /** Gaussians of the last picture. */
  #shown = 0;
  #changedMs = -Infinity;
  readonly #playout = new Playout();
  readonly #colors = new ColorPlayout();
  /** A picture has been shown. */
  standing = false;
  scene: Scene = kNoScene;
  /** Of the last order; a browser's clock may not tell it from 0. */
  sortMs: number | null = null;

  constructor(
    private readonly wanted: Api | null,
    /** Everything is wanted, through this port, in place of the Gaussians that are shown. */
    private readonly attach: (port: MessagePort, shown: number) => void,
    /** As many batches are in what is drawn from now on. */
    private readonly taken: (batches: number) => void,
    private readonly say: (problem: 'lost' | 'found' | { missing: string }) => void,
  ) {
    this.element.append(this.#still.element);
  }

  get renderer(): Renderer | null {
    return this.#renderer;
  }
  get uploadedRows(): number {
    return this.#uploadedBefore + (this.#renderer?.uploaded.rows ?? 0);
  }

  async start(): Promise<void> {
    clearTimeout(this.#startsAgain);
    const start = ++this.#newest;
    const canvas = make('canvas');
    let renderer: Renderer;
    try {
      renderer = await makeRenderer(canvas, this.wanted, this.#lent !== null);
    } catch (error) {
      if (start !== this.#newest) return;
      this.say({ missing: error instanceof Error ? error.message : String(error) });
      this.#startAgain();
      return;
    }
    if (start !== this.#newest) {
      renderer.dispose();
      return;
    }
    this.#devices.started(performance.now());
    this.#canvas.remove();
    this.#canvas = canvas;
    canvas.hidden = true;
    this.element.append(canvas);
    this.#renderer = renderer;
    this.#colors.restart(0);
    this.#fed = false;
    this.say('found');
    void renderer.lost.then((reason) => {
      if (this.#renderer !== renderer) return;
      console.warn(reason);
      this.#drop();
      this.say('lost');
      this.#startAgain();
      if (renderer.api === 'webgpu' && this.#devices.inARow >= kMostLosses) giveUpWebGpu();
    });
    this.feed();
  }

  #startAgain(): void {
    this.#startsAgain = setTimeout(() => void this.start(), 1000 * this.#devices.ended(performance.now()));
  }

  #drop(): void {
    const renderer = this.#renderer;
    this.#renderer = null;
    this.#canvas.hidden = true;
    this.#uploadedBefore += renderer?.uploaded.rows ?? 0;
    renderer?.dispose();
  }

  /** One that a headset can show takes the place of what draws, until takeBack(). Null where there is none. */
  async lend(): Promise<EyeRenderer | null> {
    this.#lent ??= { before: this.#renderer?.api ?? null };
    if (!isForHeadset(this.#renderer)) {
      this.#drop();
      await this.start();
    }
    return isForHeadset(this.#renderer) ? this.#renderer : null;
  }

  /** The headset is off, or could not be used: what drew before it draws again. */
  takeBack(): void {
    const lent = this.#lent;
    this.#lent = null;
    if (!lent || (this.#renderer && this.#renderer.api === lent.before)) return;
    this.#drop();
    void this.start();
  }

  /** Asks for everything anew: after a start of the renderer, of the sorter or of the stream. */
  feed(): void {
    clearTimeout(this.#feedsAgain);
    this.#feedsAgain = undefined;
    if (!this.#renderer) return;
    this.#source?.close();
    this.#source = null;
    this.#sorter?.terminate();
    this.#sorter = null;
    this.#sorting = false;
    this.#batches = [];
    this.#order = null;
    const { port1, port2 } = new MessageChannel();
    if (this.#renderer.sortsItself) {
      this.#source = port1;
      this.sortMs = null; // nobody measures it
      port1.onmessage = ({ data }: MessageEvent<SceneBatch>) => {
        if (this.#source === port1) this.#batches.push(data);
      };
    } else {
      this.#startSorter(port1);
    }
    this.attach(port2, this.#shown);
  }

  #startSorter(source: MessagePort): void {
    const sorter = new Worker('sort_worker.js', { type: 'module', name: 'sort' });
    this.#sorter = sorter;
    this.#sorters.started(performance.now());
    sorter.onmessage = ({ data }: MessageEvent<Sorted>) => {
      if (this.#sorter !== sorter) return;
      this.#batches.push(...data.batches);
      this.#order = data.order;
      this.sortMs = data.milliseconds;
      this.#sorting = false;
      this.#sortDue();
    };
    sorter.onerror = () => {
      // Whatever else it was told goes wrong as well. It is ended with the start of the next: of one that is gone nobody learns why.
      if (this.#sorter !== sorter || this.#feedsAgain !== undefined) return;
      this.#feedsAgain = setTimeout(() => this.feed(), 1000 * this.#sorters.ended(performance.now()));
    };
    const message: ToSortWorker = { kind: 'source', port: source };
    sorter.postMessage(message, [source]);
    this.#viewDue = true;
    this.#sortDue();
  }

  /** From where rows have to be sorted. */
  lookFrom(viewFromWorld: Float64Array): void {
    this.#view = viewFromWorld;
    this.#viewDue = true;
    this.#sortDue();
  }

  #sortDue(): void {
    if (!this.#sorter || this.#sorting || !this.#viewDue || !this.#view) return;
    const message: ToSortWorker = { kind: 'view', viewFromWorld: this.#view };
    this.#viewDue = false;
    this.#sorting = true;
    this.#sorter.postMessage(message);
  }

  /** Takes what has come for the next frame, and colors of which the time has come; true if there was something. */
  take(nowMs: number): boolean {
    const renderer = this.#renderer;
    if (!renderer) return false;
    const came = this.#takeBatches(renderer, nowMs);
    return this.#colors.advance(this.#playout.timeAt(nowMs), renderer) || came;
  }

  #takeBatches(renderer: Renderer, nowMs: number): boolean {
    if (this.#batches.length === 0 && !this.#order) return false;
    for (const { whole, update, colors, scene, time, shown } of this.#batches) {
      if (whole) renderer.clear();
      if (whole) this.#colors.restart(time.colorsMs);
      if (update.rows.length > 0) this.#changedMs = nowMs;
      renderer.apply(update);
      this.#colors.wrote(update.rows);
      this.#colors.add(colors, time.colorsMs, time.captureMs);
      this.scene = scene;
      this.#shown = shown;
      this.#playout.add(scene, time);
    }
    this.taken(this.#batches.length);
    if (this.#batches.length > 0) this.#fed = true;
    this.#batches = [];
    if (this.#order) renderer.setOrder(this.#order);
    this.#order = null;
    if (this.scene !== kNoScene) this.standing = true;
    return true;
  }

  /** The scene with its objects where they are to be seen now, before the background of then. */
  sceneAt(nowMs: number): Scene {
    const played = this.#playout.at(nowMs);
    return played ? { ...this.scene, transforms: played.transforms, background: played.background } : this.scene;
  }
  /** Of the last take(), as Frame has it. */
  get colorPart(): number {
    return this.#colors.part;
  }
  /** Rows still fade, or an object or a color is on its way to what it was last. */
  movingAt(nowMs: number): boolean {
    return nowMs - this.#changedMs < 1000 * kFadeS || this.#playout.movingAt(nowMs) || this.#colors.moving;
  }

  /** What the splats look like, at this moment, in memory. */
  async capture(frame: Frame): Promise<Picture | null> {
    return (await this.#renderer?.capture(frame)) ?? null;
  }

  /** How long ago that was what is shown; null where nobody knows: see Playout. */
  ageMs(nowMs: number): number | null {
    return this.#playout.ageMs(nowMs);
  }

  /** False: there is nothing to draw yet, or nothing to draw with. */
  draw(frame: Frame, atRest: boolean): boolean {
    const renderer = this.#renderer;
    if (!renderer || !this.#fed) return false;
    renderer.draw(frame);
    const counts = (): boolean => this.#renderer === renderer && !renderer.isLost;
    if (!counts()) return false;
    this.#canvas.hidden = false;
    this.#still.take(this.#canvas, atRest, counts);
    return true;
  }

  /** The same, up to the picture's end on the GPU. No still is kept, for it may take longer than the picture. */
  async drawToEnd(frame: Frame): Promise<boolean> {
    const renderer = this.#renderer;
    if (!renderer || !this.#fed) return false;
    renderer.draw(frame);
    await renderer.finish();
    return this.#renderer === renderer && !renderer.isLost;
  }
}
