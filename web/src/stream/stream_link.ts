import { Restarts } from '../restarts';
import { Arrival } from './arrival';
import type { Budget, FromStreamWorker, ToStreamWorker } from './messages';
import { saysOutOfMemory } from './out_of_memory';

export interface LinkOptions {
  readonly socket: string;
  readonly token: string | null;
  budget: Budget;
}

/** The stream worker, started again whenever it dies. */
export class StreamLink {
  #worker: Worker | null = null;
  #startsAgain: ReturnType<typeof setTimeout> | undefined;
  readonly #deaths = new Restarts(0.25, 8);
  /** Of a model that does not fit: each has cost most of its download, however long that took. */
  readonly #tooLarge = new Restarts(5, 300);
  #arrival = new Arrival();
  #open = false;
  #settled = false;
  /** There has been all of the model that is to come. */
  #whole = false;
  onMessage: (message: FromStreamWorker) => void = () => {};
  /** A worker has started that knows nothing of who draws. */
  onStarted: () => void = () => {};

  constructor(private readonly options: LinkOptions) {}

  /** No more of the model comes, by the last figures. */
  get settled(): boolean {
    return this.#settled;
  }

  start(): void {
    clearTimeout(this.#startsAgain); // somebody else was sooner
    this.#worker?.terminate();
    const worker = new Worker('stream_worker.js', { type: 'module', name: 'stream' });
    this.#worker = worker;
    this.#arrival = new Arrival();
    this.#open = this.#settled = this.#whole = false;
    this.#deaths.started(performance.now());
    const died = (reason: string): void => {
      if (this.#worker !== worker) return;
      console.warn(`the stream's worker has died: ${reason}`);
      worker.terminate();
      this.#worker = null;
      this.#open = this.#settled = false;
      const tooLarge = saysOutOfMemory(reason);
      const now = performance.now();
      const retryS = tooLarge ? this.#tooLarge.ended(now, this.#whole) : this.#deaths.ended(now);
      this.onMessage({ kind: 'connection', state: 'waiting', retryS, died: tooLarge ? 'out of memory' : 'by itself' });
      this.#startsAgain = setTimeout(() => this.start(), 1000 * retryS);
    };
    worker.onerror = ({ message }) => died(message ?? 'its script');
    worker.onmessageerror = () => died('a message');
    worker.onmessage = ({ data }: MessageEvent<FromStreamWorker>) => {
      if (worker !== this.#worker) return;
      if (data.kind === 'failed') {
        died(data.reason);
      } else {
        if (data.kind === 'connection') this.#open = data.state === 'open';
        if (data.kind === 'figures') this.#settled = this.#arrival.settled(data.figures, this.#open, performance.now());
        this.#whole ||= this.#settled;
        this.onMessage(data);
      }
    };
    this.send({ kind: 'start', ...this.options, clockOriginMs: performance.timeOrigin });
    this.onStarted();
  }

  /** The model is asked for anew where it is to have another size. */
  setBudget(budget: Budget): void {
    const { gaussians, megabits } = this.options.budget;
    this.options.budget = budget;
    if (budget.megabits !== megabits) this.send({ kind: 'rate', megabits: budget.megabits });
    if (budget.gaussians === gaussians) return;
    this.#tooLarge.reset();
    this.start();
  }

  /** Nothing while there is no worker: who starts one is told. */
  send(message: ToStreamWorker, transfer: Transferable[] = []): void {
    this.#worker?.postMessage(message, transfer);
  }

  /** The page goes. */
  leave(): void {
    this.send({ kind: 'farewell' });
  }

  /** For tests of what comes after. */
  kill(): void {
    this.#worker?.dispatchEvent(new Event('error'));
  }
}
