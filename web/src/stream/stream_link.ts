import { Backoff } from '../backoff';
import type { Budget, FromStreamWorker, ToStreamWorker } from './messages';

export interface LinkOptions {
  readonly socket: string;
  readonly token: string | null;
  budget: Budget;
}

/** The stream worker, started again whenever it dies. */
export class StreamLink {
  #worker: Worker | null = null;
  #startsAgain: ReturnType<typeof setTimeout> | undefined;
  readonly #backoff = new Backoff(0.25, 8);
  onMessage: (message: FromStreamWorker) => void = () => {};
  /** A worker has started that knows nothing of who draws. */
  onStarted: () => void = () => {};

  constructor(private readonly options: LinkOptions) {}

  start(): void {
    clearTimeout(this.#startsAgain); // somebody else was sooner
    this.#worker?.terminate();
    const worker = new Worker('stream_worker.js', { type: 'module', name: 'stream' });
    this.#worker = worker;
    const died = (): void => {
      if (this.#worker !== worker) return;
      worker.terminate();
      this.#worker = null;
      const retryS = this.#backoff.seconds();
      this.onMessage({ kind: 'connection', state: 'waiting', retryS });
      this.#startsAgain = setTimeout(() => this.start(), 1000 * retryS);
    };
    worker.onerror = died;
    worker.onmessageerror = died;
    worker.onmessage = ({ data }: MessageEvent<FromStreamWorker>) => {
      if (data.kind === 'failed') {
        console.warn(data.reason);
        died();
      } else {
        if (data.kind === 'connection' && data.state === 'open') this.#backoff.reset();
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
    this.start();
  }

  /** Nothing while there is no worker: who starts one is told. */
  send(message: ToStreamWorker, transfer: Transferable[] = []): void {
    this.#worker?.postMessage(message, transfer);
  }

  /** For tests of what comes after. */
  kill(): void {
    this.#worker?.dispatchEvent(new Event('error'));
  }
}
