// Follows the stream: bytes from the WebSocket into the WebAssembly module, rows out of it to whoever draws them.
import { Connection } from './connection';
import { FiguresDue } from './figures_due';
import type { FromStreamWorker, StreamFigures, ToStreamWorker, WorkerScope } from './messages';
import { Publisher } from './publisher';
import { Follower, loadWasm, type FollowerStats } from './wasm';

const kWatchMs = 50;
const kRoundTripMs = 2000;
/** Of all pages, in a model that may take the place of one that is seen. */
const kMostMissing = 0.02;
/** Rows handed on at once, so that what a frame uploads is bounded. */
const kMostRows = 65536;

const scope = self as unknown as WorkerScope<ToStreamWorker, FromStreamWorker>;

/** A model that changes misses a page now and then. */
const isWhole = ({ pages, missingPages }: FollowerStats): boolean => pages > 0 && missingPages <= kMostMissing * pages;

class Stream {
  readonly #follower: Follower;
  readonly #publisher: Publisher;
  readonly #connection: Connection;
  /** Of the page's clock. */
  readonly #aheadMs: number;
  #due = false;
  #shownVersion = -1;
  readonly #figuresDue = new FiguresDue();
  #warned = 0;
  #roundTripMs = -1;
  readonly #turn = new MessageChannel();

  constructor(wasm: Awaited<ReturnType<typeof loadWasm>>, start: Extract<ToStreamWorker, { kind: 'start' }>) {
    this.#follower = new Follower(wasm, 'page', start.budget.gaussians, performance.now());
    this.#follower.setMaxKbps(1000 * start.budget.megabits);
    this.#aheadMs = performance.timeOrigin - start.clockOriginMs;
    this.#publisher = new Publisher(() => (performance.now() + this.#aheadMs) / 1000, start.budget.gaussians);
    this.#connection = new Connection(start.socket, start.token, {
      opened: () => {
        this.#follower.restart();
        this.#speak();
      },
      message: (bytes) => this.#hear(bytes),
      state: (state, retryS) => {
        scope.postMessage({ kind: 'connection', state, retryS });
        this.#figuresDue.hurry();
        this.#tell(this.#follower.stats);
      },
    });
    this.#turn.port1.onmessage = () => this.#publish();
    this.#connection.start();
    setInterval(() => this.#watch(), kWatchMs);
    setInterval(() => void this.#measureRoundTrip(), kRoundTripMs);
  }

  take(message: Exclude<ToStreamWorker, { kind: 'start' }>): void {
    switch (message.kind) {
      case 'attach':
        this.#publisher.attach(message.port, message.shown);
        break;
      case 'taken':
        for (let i = 0; i < message.batches; ++i) this.#publisher.taken();
        this.#publishSoon();
        break;
      case 'pose':
        this.#follower.setPose(message.floats);
        this.#speak();
        break;
      case 'rate':
        this.#follower.setMaxKbps(1000 * message.megabits);
        this.#speak();
        break;
      case 'probe':
        this.#follower.askPicture(message.probeId, message.floats);
        this.#speak();
        break;
      case 'bounds': {
        const bounds = this.#publisher.bounds();
        if (bounds) scope.postMessage({ kind: 'bounds', ...bounds });
        break;
      }
      case 'pick':
        scope.postMessage({ kind: 'pick', number: message.number, point: this.#publisher.pick(message.at) });
        break;
      case 'farewell':
        this.#connection.leave(this.#follower.farewell());
        break;
    }
  }

  #hear(bytes: ArrayBuffer): void {
    const result = this.#follower.receive(bytes, performance.now());
    if (result === 'refused' && this.#warned++ < 10) console.warn(`a packet was refused: ${this.#follower.error}`);
    if (result === 'out of memory') {
      scope.postMessage({ kind: 'failed', reason: 'out of memory: the model does not fit' });
      scope.close(); // nothing more is shown of what is half gone
      return;
    }
    for (let picture = this.#follower.takePicture(); picture; picture = this.#follower.takePicture()) {
      scope.postMessage({ kind: 'picture', picture }, [picture.rgba.buffer, picture.transforms.buffer]);
    }
    this.#speak();
    this.#publishSoon();
  }

  #speak(): void {
    while (this.#connection.open) {
      const message = this.#follower.nextOutgoing(performance.now());
      if (!message) return;
      this.#connection.send(message);
    }
  }

  /** After what has been received already. */
  #publishSoon(): void {
    if (this.#due) return;
    this.#due = true;
    this.#turn.port2.postMessage(null);
  }

  #publish(): void {
    this.#due = false;
    const follower = this.#follower;
    if (!this.#publisher.ready) {
      this.#tell(follower.stats);
      return;
    }
    const changed = follower.takeChanges(kMostRows);
    const [rows, records] = [changed.rows.slice(), changed.records.slice()];
    const turnover = { origins: changed.turnover.origins.slice(), left: changed.turnover.left.slice() };
    const harmonics = changed.harmonics && { words: changed.harmonics.words, values: changed.harmonics.values.slice() };
    const recolored = follower.takeColors(kMostRows);
    const colors = { rows: recolored.rows.slice(), colors: recolored.colors.slice() };
    const stats = follower.stats;
    this.#tell(stats);
    if (rows.length === 0 && colors.rows.length === 0 && stats.sceneVersion === this.#shownVersion) return;
    this.#shownVersion = stats.sceneVersion;
    const scene = {
      transforms: follower.transforms.slice(),
      farField: follower.farFieldIndex,
      player: follower.playerIndex,
      background: follower.background,
      displaySpace: stats.radiance,
    };
    const more = rows.length >= kMostRows || colors.rows.length === kMostRows;
    const time = { captureMs: stats.sceneCaptureMs, arrivedMs: stats.sceneArrivedMs + this.#aheadMs, colorsMs: stats.colorsMs };
    this.#publisher.publish({ rows, records, turnover, harmonics }, colors, scene, time, isWhole(stats) && !more);
    if (more) this.#publishSoon();
  }

  #watch(): void {
    this.#connection.watch();
    this.#speak();
    this.#publisher.tidy();
    this.#tell(this.#follower.stats);
  }

  #tell(stats: FollowerStats): void {
    const figures = this.#figures(stats, performance.now());
    if (this.#figuresDue.take(figures)) scope.postMessage({ kind: 'figures', figures });
  }

  /** To the gateway and back, by a request that costs it nothing. */
  async #measureRoundTrip(): Promise<void> {
    if (!this.#connection.open) return;
    const start = performance.now();
    const answer = await fetch('healthz', { method: 'HEAD', cache: 'no-store' }).catch(() => null);
    this.#roundTripMs = answer ? performance.now() - start : -1;
  }

  #figures(stats: FollowerStats, nowMs: number): StreamFigures {
    return {
      atMs: nowMs,
      gaussians: stats.gaussians,
      sequence: stats.sequence,
      epoch: stats.epoch,
      sceneVersion: stats.sceneVersion,
      missing: stats.pages > 0 ? stats.missingPages : -1,
      bytes: stats.bytesIn,
      ageMs: stats.sceneArrivedMs > 0 ? nowMs - stats.sceneArrivedMs : -1,
      roundTripMs: this.#roundTripMs,
    };
  }
}

let stream: Promise<Stream> | null = null;
scope.onmessage = ({ data }) => {
  const failed = (error: unknown): void => scope.postMessage({ kind: 'failed', reason: String(error) });
  // A promise would keep to itself what went wrong: a module that has trapped is not to be called again.
  if (data.kind !== 'start') void stream?.then((running) => running.take(data)).catch(failed);
  else (stream = loadWasm('splatbus.wasm').then((wasm) => new Stream(wasm, data))).catch(failed);
};
