import { addressWith } from './camera/address';
import { Controls } from './camera/controls';
import { Rig, viewOf } from './camera/rig';
import { Flight, postFigures } from './bench';
import type { View } from './math';
import { Pace, Rate } from './pace';
import type { Api } from './render/make_renderer';
import type { Frame } from './render/renderer';
import { savePng } from './snapshot';
import { Stage } from './stage';
import type { ConnectionState, FromStreamWorker, StreamFigures } from './stream/messages';
import { StreamLink } from './stream/stream_link';
import { texts } from './texts';
import { make, button } from './ui/dom';
import { Menu } from './ui/menu';
import { Notice, Overlay } from './ui/overlay';
import { keepSettings, kBackgrounds, kResolutions, type Settings } from './ui/settings';

const kPoseEveryMs = 50;
const kAddressEveryMs = 500;
const kFiguresEveryMs = 250;
const kSettleMs = 150;

export interface ViewerOptions {
  readonly api: Api | null;
  readonly socket: string;
  readonly token: string | null;
  readonly settings: Settings;
  /** Seconds of a flight that is measured; 0: none. */
  readonly bench: number;
}

/** The page: stream, picture, camera, figures and menu. */
export class Viewer {
  readonly rig = new Rig();
  readonly stage: Stage;
  readonly link: StreamLink;
  readonly #controls: Controls;
  readonly #overlay = new Overlay();
  readonly #notice = new Notice();
  readonly #menu: Menu;
  readonly #pace = new Pace();
  readonly #rate = new Rate();
  /** The last that the stream's worker said. */
  figures: StreamFigures | null = null;
  connection: ConnectionState = 'connecting';
  #retryAtMs = 0;
  #graphics = '';
  #lastMs = 0;
  #movedMs = 0;
  #changedMs = 0;
  #poseMs = 0;
  #figuresMs = 0;
  #addressMs = 0;
  #lookedFrom: Float64Array | null = null;
  #drawn = { width: 0, height: 0, resolution: 0 };
  #goal = this.rig.goal;
  /** Somebody has moved the camera. */
  #steered = false;
  #rested = true;
  #redraw = true;
  #framed = false;
  #flight: Flight | null = null;
  #benchAsked: boolean;
  #benchDue = false;
  /** Pictures drawn since the page was opened. */
  frames = 0;

  constructor(
    root: HTMLElement,
    private readonly options: ViewerOptions,
  ) {
    this.#benchAsked = options.bench > 0;
    this.rig.smooth = !matchMedia('(prefers-reduced-motion: reduce)').matches;
    this.link = new StreamLink({ socket: options.socket, token: options.token, budget: options.settings.budget });
    this.stage = new Stage(
      options.api,
      (port, standing) => this.link.send({ kind: 'attach', port, standing }, [port]),
      (batches) => this.link.send({ kind: 'taken', batches }),
      (problem) => {
        this.#graphics = problem === 'found' ? '' : problem === 'lost' ? texts.graphicsLost : texts.graphicsMissing(problem.missing);
        this.#redraw = true;
      },
    );
    this.stage.element.setAttribute('aria-label', texts.picture);
    this.#controls = new Controls(this.stage.element, this.rig);
    this.#controls.onFrameAll = () => this.frameAll();
    this.#menu = new Menu(options.settings, {
      frameAll: () => this.frameAll(),
      fullScreen: () => this.#toggleFullScreen(),
      snapshot: () => void this.#saveSnapshot(),
      share: () => void this.#share(),
      figures: () => this.#overlay.toggle(),
      changed: () => this.#settingsChanged(),
    });
    const bar = make('div', { class: 'bar' }, button(texts.menu, () => this.#menu.toggle()));
    root.append(this.stage.element, this.#overlay.element, this.#controls.stick.element, bar, this.#menu.element, this.#notice.element);
    addEventListener('keydown', (event) => this.#key(event));
    this.link.onMessage = (message) => this.#hear(message);
    this.link.onStarted = () => this.stage.feed();
  }

  start(): void {
    void this.stage.start();
    this.link.start();
    this.stage.element.focus({ preventScroll: true });
    const tick = (nowMs: number): void => {
      requestAnimationFrame(tick);
      this.#tick(nowMs);
    };
    requestAnimationFrame(tick);
  }

  /** A view came with the address: nothing else is shown of its own accord. */
  keepView(): void {
    this.#framed = true;
  }

  frameAll(): void {
    this.link.send({ kind: 'bounds' });
  }

  #tick(nowMs: number): void {
    const seconds = Math.max(0, (nowMs - this.#lastMs) / 1000);
    this.#lastMs = nowMs;
    this.#controls.advance(seconds);
    if (this.rig.goal !== this.#goal) this.#steered = true;
    this.#fly(nowMs);
    this.#goal = this.rig.goal;
    const moved = this.rig.advance(seconds);
    if (moved) this.#movedMs = nowMs;
    if (this.stage.take(nowMs)) this.#changedMs = nowMs;
    const view = this.#view();
    this.#announce(view, nowMs);
    this.#draw(view, nowMs);
    if (nowMs - this.#figuresMs > kFiguresEveryMs) {
      this.#figuresMs = nowMs;
      this.#showFigures(nowMs);
    }
    if (this.#steered && !this.#flight && nowMs - this.#addressMs > kAddressEveryMs && nowMs - this.#movedMs > kSettleMs) {
      this.#addressMs = nowMs;
      const address = addressWith(new URL(location.href), this.rig.goal);
      if (address !== location.href) history.replaceState(null, '', address);
    }
  }

  #view(): View {
    const { clientWidth, clientHeight } = this.stage.element;
    const side = (css: number): number => Math.max(8, Math.round(css * devicePixelRatio));
    return viewOf(this.rig.shown, side(clientWidth), side(clientHeight));
  }

  /** While something moves as fine as it can be drawn in time; at rest, and where a person chose, as that says. */
  #resolution(nowMs: number): number {
    const { quality } = this.options.settings;
    if (quality !== 'auto') return kResolutions[quality];
    return nowMs - Math.max(this.#movedMs, this.#changedMs) > kSettleMs ? 1 : this.#pace.resolution;
  }

  #draw(view: View, nowMs: number): void {
    const resolution = this.#resolution(nowMs);
    const drawn = this.#drawn;
    const resized = drawn.width !== view.width || drawn.height !== view.height || drawn.resolution !== resolution;
    const moving = nowMs === this.#movedMs || nowMs === this.#changedMs || this.stage.movingAt(nowMs);
    const settled = !moving && nowMs - Math.max(this.#movedMs, this.#changedMs) > kSettleMs;
    if (!this.stage.renderer || (!moving && !resized && !this.#redraw && !(settled && !this.#rested))) return;
    this.#redraw = false;
    this.#drawn = { width: view.width, height: view.height, resolution };
    this.#rested = settled;
    this.stage.draw(this.#frame(view, resolution, nowMs), settled);
    ++this.frames;
    if (moving) this.#pace.drawn(nowMs);
    else this.#pace.rest();
  }

  #frame(view: View, resolution: number, nowMs: number): Frame {
    const { background } = this.options.settings;
    const scene = this.stage.sceneAt(nowMs);
    return {
      view,
      scene: background === 'scene' ? scene : { ...scene, background: kBackgrounds[background] },
      resolution,
      timeS: nowMs / 1000,
    };
  }

  /** Where the camera is, to those who sort and to the streamer. */
  #announce(view: View, nowMs: number): void {
    const { viewFromWorld } = view;
    const moved = !this.#lookedFrom || viewFromWorld.some((value, i) => value !== this.#lookedFrom?.[i]);
    if (moved) {
      this.stage.lookFrom(viewFromWorld);
      this.#lookedFrom = viewFromWorld;
    }
    if (nowMs - this.#poseMs < kPoseEveryMs) return;
    this.#poseMs = nowMs;
    const floats = new Float32Array([...viewFromWorld, view.fx, view.fy, view.cx, view.cy, view.width, view.height]);
    this.link.send({ kind: 'pose', floats }, [floats.buffer]);
  }

  #hear(message: FromStreamWorker): void {
    if (message.kind === 'figures') {
      this.figures = message.figures;
      this.#rate.add(message.figures.atMs, message.figures.bytes);
      const unframed = !this.#framed && !this.#steered;
      if (message.figures.gaussians > 0 && (unframed || (this.#benchAsked && this.stage.standing))) {
        this.#framed = true;
        this.#benchDue = this.#benchAsked;
        this.#benchAsked = false;
        this.frameAll();
      }
    } else if (message.kind === 'bounds') {
      this.#showAll(message.centre, message.radius);
    } else if (message.kind === 'connection') {
      this.connection = message.state;
      this.#retryAtMs = message.state === 'waiting' ? performance.now() + 1000 * message.retryS : 0;
    }
  }

  #showAll(centre: [number, number, number], radius: number): void {
    if (this.#benchDue) {
      this.#benchDue = false;
      this.#flight = new Flight(centre, radius, this.options.bench);
    }
    const { clientWidth, clientHeight } = this.stage.element;
    this.rig.frame(centre, radius, clientWidth, clientHeight);
    if (!this.stage.standing) this.rig.jump(this.rig.goal);
    if (!this.#steered) this.#goal = this.rig.goal;
  }

  #fly(nowMs: number): void {
    if (!this.#flight) return;
    const pose = this.#flight.at(nowMs / 1000);
    if (pose) {
      this.rig.jump(pose);
      this.#movedMs = nowMs;
      return;
    }
    const flown = this.#flight;
    this.#flight = null;
    void this.#report(flown);
  }

  async #report(flight: Flight): Promise<void> {
    const figures = flight.figures();
    const { width, height } = this.#view();
    const report = {
      ...figures,
      api: this.stage.renderer?.api ?? 'none',
      width,
      height,
      gaussians: this.figures?.gaussians ?? 0,
      resolution: this.#pace.resolution,
      sortMs: this.stage.sortMs,
      browser: navigator.userAgent,
    };
    const posted = await postFigures(report, this.options.token);
    document.body.dataset.bench = JSON.stringify(report);
    this.#benchText = `${texts.benchDone(figures.framesPerSecond, figures.medianMs)} ${posted ? texts.benchPosted : texts.benchKept}`;
  }
  #benchText = '';

  #showFigures(nowMs: number): void {
    const figures = this.figures;
    const known = (value: number | undefined, show: (value: number) => string): string =>
      value === undefined || value < 0 ? texts.unknown : show(value);
    const moving = this.#pace.frameMs > 0;
    const connection = this.connection === 'open' ? texts.connected : texts.connecting;
    const waiting = Math.max(0, (this.#retryAtMs - nowMs) / 1000);
    this.#overlay.show({
      frames: moving ? this.#pace.framesPerSecond.toFixed(0) : texts.rows.atRest,
      frame: moving ? texts.ms(this.#pace.frameMs) : texts.unknown,
      sort: this.stage.sortMs > 0 ? texts.ms(this.stage.sortMs) : texts.unknown,
      gaussians: known(figures?.gaussians, (n) => n.toLocaleString('en')),
      rate: this.#rate.megabits.toFixed(2),
      roundTrip: known(figures?.roundTripMs, texts.ms),
      age: known(figures?.ageMs, texts.ms),
      missing: known(figures?.missing, texts.pages),
      uploaded: this.stage.uploadedRows.toLocaleString('en'),
      resolution: `${Math.round(100 * this.#drawn.resolution)} %`,
      drawnBy: this.stage.renderer ? texts.apis[this.stage.renderer.api] : texts.unknown,
      connection: this.#retryAtMs > 0 ? texts.reconnecting(waiting) : connection,
    });
    const problem =
      this.#graphics ||
      (this.#retryAtMs > 0 ? texts.reconnecting(waiting) : '') ||
      (this.#flight ? texts.benchRunning(this.#flight.part(nowMs / 1000)) : this.#benchText) ||
      (this.stage.standing ? '' : this.connection === 'open' ? texts.waitingForScene : texts.connecting);
    this.#notice.keep(problem);
  }

  #settingsChanged(): void {
    keepSettings(this.options.settings);
    this.link.setBudget(this.options.settings.budget);
    this.#redraw = true;
  }

  async #saveSnapshot(): Promise<void> {
    const { renderer } = this.stage;
    if (!renderer) return;
    const picture = await renderer.capture(this.#frame(this.#view(), 1, performance.now()));
    await savePng(picture, `splatbus-${new Date().toISOString().replaceAll(':', '-').slice(0, 19)}.png`);
  }

  async #share(): Promise<void> {
    const address = addressWith(new URL(location.href), this.rig.goal);
    history.replaceState(null, '', address);
    await navigator.clipboard?.writeText(address).then(() => this.#notice.pass(texts.shared));
  }

  #toggleFullScreen(): void {
    void (document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen()).catch(() => {});
  }

  #key(event: KeyboardEvent): void {
    if (event.code === 'Escape') this.#menu.element.close();
    if (event.ctrlKey || event.metaKey || event.altKey || event.target instanceof HTMLSelectElement) return;
    if (this.#controls.keys.press(event.code)) {
      event.preventDefault();
      return;
    }
    if (event.repeat) return;
    const actions: Readonly<Record<string, () => void>> = {
      KeyF: () => this.frameAll(),
      KeyI: () => this.#overlay.toggle(),
      KeyM: () => this.#menu.toggle(),
      KeyP: () => void this.#saveSnapshot(),
      KeyV: () => this.#toggleFullScreen(),
    };
    actions[event.code]?.();
  }
}
