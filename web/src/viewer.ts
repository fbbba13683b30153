import { KeptAddress } from './camera/address';
import { Controls } from './camera/controls';
import { Player } from './camera/player';
import { Rig, viewOf, type Pose } from './camera/rig';
import { BenchRun } from './bench';
import type { ModelFile } from './download';
import { Extras } from './extras';
import { poseFloats, type View } from './math';
import { Overview } from './overview';
import { Pace } from './pace';
import type { Api } from './render/make_renderer';
import type { Frame } from './render/renderer';
import { Stage } from './stage';
import { Status } from './status';
import type { Budget, ConnectionState, FromStreamWorker, StreamFigures } from './stream/messages';
import { StreamLink } from './stream/stream_link';
import { texts } from './texts';
import { make } from './ui/dom';
import { Menu } from './ui/menu';
import { keepSettings, kResolutions, kSpeeds, sceneBefore, type Settings } from './ui/settings';
import { takeShortcuts } from './ui/shortcuts';
import { canImmerse } from './xr/immersion';

const kPoseEveryMs = 50;
const kSettleMs = 150;
/** Turns of the display, of which a slow one is longer than that. */
const kSettleTurns = 3;

export interface ViewerOptions {
  readonly api: Api | null;
  readonly socket: string;
  readonly token: string | null;
  /** As Frame's. */
  readonly mip: boolean;
  readonly settings: Settings;
  /** Seconds of a flight that is measured; 0: none. */
  readonly bench: number;
}

/** The page: stream, picture, camera, figures and menu. */
export class Viewer {
  readonly rig = new Rig();
  readonly stage: Stage;
  readonly link: StreamLink;
  /** How the stream is got; the token is of who looks now. */
  readonly #access: { readonly socket: string; token: string | null; budget: Budget };
  readonly #controls: Controls;
  readonly #status: Status;
  readonly #menu: Menu;
  readonly #pace = new Pace();
  #lastMs = 0;
  #movedMs = 0;
  #changedMs = 0;
  /** Since something moved. */
  #stillTurns = 0;
  #poseMs = 0;
  readonly #address = new KeptAddress();
  #lookedFrom: Float64Array | null = null;
  #drawn = { width: 0, height: 0, resolution: 0 };
  #goal = this.rig.goal;
  /** Somebody has moved the camera. */
  #steered = false;
  readonly #player = new Player();
  #rested = true;
  #redraw = true;
  readonly overview: Overview;
  readonly #bench: BenchRun;
  readonly extras: Extras;
  /** Pictures drawn since the page was opened. */
  frames = 0;
  /** When the first was drawn that shows something, after the page was opened; 0: not yet. */
  firstPictureMs = 0;

  constructor(
    root: HTMLElement,
    private readonly options: ViewerOptions,
  ) {
    this.rig.smooth = !matchMedia('(prefers-reduced-motion: reduce)').matches;
    this.rig.speed = kSpeeds[options.settings.speed];
    this.#access = { socket: options.socket, token: options.token, budget: options.settings.budget };
    this.link = new StreamLink(this.#access);
    this.stage = new Stage(
      options.api,
      (port, shown) => this.link.send({ kind: 'attach', port, shown }, [port]),
      (batches) => this.link.send({ kind: 'taken', batches }),
      (problem) => {
        this.#status.graphics = problem === 'found' ? '' : problem === 'lost' ? texts.graphicsLost : texts.graphicsMissing(problem.missing);
        this.#redraw = true;
      },
    );
    this.#bench = new BenchRun(options.bench, options.token, this.stage, {
      told: () => ({ ...this.#drawn, gaussians: this.figures?.gaussians ?? 0 }),
      drawToEnd: (pose) => this.#drawToEnd(pose),
    });
    this.overview = new Overview(this.stage, this.rig, this.link);
    this.#status = new Status(this.stage, this.#pace, this.#access, options.settings);
    this.extras = new Extras(this.stage, this.rig, this.link, this.#access, {
      view: () => this.#view(),
      frame: (shown, resolution, nowMs) => this.#frame(shown, resolution, nowMs),
      announce: (shown, nowMs) => this.#announce(shown, nowMs),
      resolution: () => this.#resolution(this.#movedMs), // a head never rests
      drawn: (nowMs) => {
        ++this.frames;
        this.#pace.drawn(nowMs);
      },
      redraw: () => (this.#redraw = true),
      notice: (text) => this.#status.notice.pass(text),
    }, options.mip);
    this.stage.element.setAttribute('aria-label', texts.picture);
    this.#controls = new Controls(this.stage.element, this.rig);
    this.#controls.onFrameAll = () => this.#leavePlayer(() => this.overview.ask());
    this.#controls.onPick = (right, down) => this.extras.picking.at(right, down);
    const actions = {
      frameAll: () => this.#leavePlayer(() => this.overview.ask()),
      resetView: () => this.#leavePlayer(() => this.overview.reset()),
      fullScreen: () => this.extras.toggleFullScreen(),
      snapshot: () => void this.extras.saveSnapshot(),
      share: () => void this.extras.share(),
      figures: () => this.#status.toggleFigures(),
      compare: () => this.#compare(),
      follow: () => this.#follow(),
      immerse: () => void this.extras.immerse(),
      download: (kind: ModelFile) => void this.extras.download(kind),
      changed: () => this.#settingsChanged(),
    };
    this.#menu = new Menu(options.settings, actions);
    takeShortcuts({
      ...actions,
      steer: (event) => this.#controls.keys.press(event),
      menu: () => this.#menu.toggle(),
      escape: () => this.#escape(),
    });
    const bar = make('div', { class: 'bar' }, this.#menu.opener);
    void canImmerse().then((can) => can && this.#menu.offerImmersion());
    root.append(this.stage.element, this.extras.comparison.element, this.#status.overlay.element, this.#controls.stick.element, bar, this.#menu.element, this.#status.notice.element, this.#status.notice.spoken);
    this.link.onMessage = (message) => this.#hear(message);
    this.link.onStarted = () => this.stage.feed();
    addEventListener('pagehide', () => this.link.leave());
    addEventListener('pageshow', ({ persisted }) => persisted && this.link.start()); // kept, and come back to
  }

  /** The last that the stream's worker said. */
  get figures(): StreamFigures | null {
    return this.#status.figures;
  }
  get connection(): ConnectionState {
    return this.#status.connection;
  }

  start(): void {
    void this.stage.start();
    this.link.start();
    // Nobody has asked to see where it is.
    this.stage.element.focus({ preventScroll: true, focusVisible: false } as FocusOptions);
    const tick = (nowMs: number): void => {
      requestAnimationFrame(tick);
      if (!this.extras.immersion) this.#tick(nowMs);
    };
    requestAnimationFrame(tick);
  }

  /** Somebody has another one now: it is connected anew. */
  useToken(token: string | null): void {
    this.#access.token = token;
    this.#bench.token = token;
    this.link.start();
  }

  #tick(nowMs: number): void {
    const seconds = Math.max(0, (nowMs - this.#lastMs) / 1000);
    this.#lastMs = nowMs;
    this.#controls.advance(seconds);
    if (this.rig.goal !== this.#goal) {
      this.#steered = true;
      this.#player.following = false;
    }
    if (this.#steered || this.#player.following) this.overview.end();
    this.overview.advance(seconds);
    const flown = this.#bench.at(nowMs / 1000);
    if (flown) this.rig.jump(flown);
    if (flown || this.#player.goAlong(this.stage.sceneAt(nowMs), this.rig)) this.#movedMs = nowMs;
    this.#goal = this.rig.goal;
    const moved = this.rig.advance(seconds);
    if (moved) this.#movedMs = nowMs;
    if (this.stage.take(nowMs)) this.#changedMs = nowMs;
    const view = this.#view();
    this.#announce(view, nowMs);
    this.#draw(view, nowMs);
    this.extras.comparison.advance(nowMs, view, this.stage.standing && nowMs - this.#movedMs > kSettleMs);
    if (this.#status.show(nowMs, this.#drawn.resolution, this.#bench.text(this.figures?.missing ?? -1))) {
      const { player } = this.stage.scene;
      const { following } = this.#player;
      this.#menu.show({ player: player > 0, following, figures: !this.#status.overlay.element.hidden, comparing: this.extras.comparison.on });
    }
    if (this.#steered && !this.#bench.flying && nowMs - this.#movedMs > kSettleMs) this.#address.keep(nowMs, this.rig.goal);
  }

  /** For another view that somebody wants. */
  #leavePlayer(go: () => void): void {
    this.#player.following = false;
    go();
  }

  #follow(): void {
    if (!this.#player.toggle(this.stage.scene)) this.#status.notice.pass(texts.noPlayer);
    else if (this.#player.following) this.#status.notice.pass(texts.following);
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
    if (this.#bench.flying) return 1; // pictures that are measured are all alike
    return nowMs - Math.max(this.#movedMs, this.#changedMs) > kSettleMs ? 1 : this.#pace.resolution;
  }

  #draw(view: View, nowMs: number): void {
    const resolution = this.#resolution(nowMs);
    const drawn = this.#drawn;
    const resized = drawn.width !== view.width || drawn.height !== view.height || drawn.resolution !== resolution;
    const moving = nowMs === this.#movedMs || nowMs === this.#changedMs || this.stage.movingAt(nowMs);
    this.#stillTurns = moving ? 0 : this.#stillTurns + 1;
    const settled = this.#stillTurns >= kSettleTurns && nowMs - Math.max(this.#movedMs, this.#changedMs) > kSettleMs;
    if (!this.stage.renderer || this.#bench.draws || (!moving && !resized && !this.#redraw && !(settled && !this.#rested))) return;
    this.#redraw = false;
    this.#drawn = { width: view.width, height: view.height, resolution };
    this.#rested = settled;
    if (!this.stage.draw(this.#frame(view, resolution, nowMs), settled)) return;
    ++this.frames;
    this.#bench.drawn(resolution);
    if (this.firstPictureMs === 0) this.firstPictureMs = performance.now();
    if (moving) this.#pace.drawn(nowMs);
    else this.#pace.rest();
  }

  /** From where a flight is, as of the last turn of the display. */
  #drawToEnd(pose: Pose): Promise<boolean> {
    this.rig.jump(pose);
    this.#goal = this.rig.goal;
    const nowMs = (this.#movedMs = this.#lastMs);
    const view = this.#view();
    this.#announce(view, nowMs);
    const resolution = this.#resolution(nowMs);
    this.#bench.drawn(resolution);
    return this.stage.drawToEnd(this.#frame(view, resolution, nowMs));
  }

  #frame(view: View, resolution: number, nowMs: number): Frame {
    const { settings, mip } = this.options;
    return { view, scene: sceneBefore(settings.background, this.stage.sceneAt(nowMs)), resolution, timeS: nowMs / 1000, colorPart: this.stage.colorPart, mip };
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
    const floats = poseFloats(view);
    this.link.send({ kind: 'pose', floats }, [floats.buffer]);
  }

  #hear(message: FromStreamWorker): void {
    const { settled } = this.link;
    this.#status.hear(message, settled);
    if (message.kind === 'figures') {
      const flies = this.#bench.asked && this.stage.standing && settled;
      if (flies) this.#bench.prepare();
      if (!this.overview.hear(message.figures, settled) && flies) this.overview.ask();
    } else if (message.kind === 'bounds') {
      this.#bench.around(message.centre, message.radius);
      if (this.overview.show(message.centre, message.radius) && !this.#steered) this.#goal = this.rig.goal;
    } else if (message.kind === 'pick') {
      this.extras.picking.hear(message.number, message.point);
    } else if (message.kind === 'picture') {
      void this.extras.comparison.hear(message.picture);
    }
  }

  #settingsChanged(): void {
    keepSettings(this.options.settings);
    this.rig.speed = kSpeeds[this.options.settings.speed];
    this.#status.askedFor(this.options.settings.budget.gaussians);
    this.link.setBudget(this.options.settings.budget);
    this.#redraw = true;
  }

  #compare(): void {
    this.#menu.element.close();
    void this.extras.compare();
  }

  #escape(): void {
    if (this.#menu.element.open) this.#menu.element.close();
    else if (this.extras.comparison.on) this.extras.comparison.toggle();
  }
}
