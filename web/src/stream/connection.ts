import { Backoff } from '../backoff';
import type { ConnectionState } from './messages';

const kSubprotocol = 'splatbus.stream.1';
const kTokenProtocol = 'splatbus.token.';
const kSilenceMs = 10_000;

/** The WebSocket to the gateway, opened again whenever it closes or falls silent. */
export class Connection {
  #socket: WebSocket | null = null;
  #heardMs = 0;
  #startsAgain: ReturnType<typeof setTimeout> | undefined;
  readonly #backoff = new Backoff(0.25, 8);

  constructor(
    private readonly url: string,
    private readonly token: string | null,
    private readonly events: {
      opened(): void;
      message(bytes: ArrayBuffer): void;
      state(state: ConnectionState, retryS: number): void;
    },
  ) {}

  get open(): boolean {
    return this.#socket?.readyState === WebSocket.OPEN;
  }

  start(): void {
    this.events.state('connecting', 0);
    const protocols = this.token === null ? [kSubprotocol] : [kSubprotocol, kTokenProtocol + this.token];
    let socket: WebSocket;
    try {
      socket = new WebSocket(this.url, protocols);
    } catch {
      this.#retry(); // a token that is none
      return;
    }
    this.#socket = socket;
    this.#heardMs = performance.now();
    socket.binaryType = 'arraybuffer';
    socket.onopen = () => {
      this.events.state('open', 0);
      this.events.opened();
    };
    socket.onmessage = ({ data }: MessageEvent<unknown>) => {
      this.#heardMs = performance.now();
      this.#backoff.reset();
      if (data instanceof ArrayBuffer) this.events.message(data);
    };
    socket.onclose = () => {
      if (this.#socket === socket) this.#retry();
    };
  }

  send(bytes: Uint8Array<ArrayBuffer>): void {
    this.#socket?.send(bytes);
  }

  /** Says this last, and is not opened again. */
  leave(last: Uint8Array<ArrayBuffer>): void {
    if (this.open) this.send(last);
    clearTimeout(this.#startsAgain);
    const socket = this.#socket;
    this.#socket = null;
    socket?.close();
  }

  /** To be called now and then. */
  watch(): void {
    const socket = this.#socket;
    if (!socket || performance.now() - this.#heardMs < kSilenceMs) return;
    this.#retry();
    socket.close();
  }

  #retry(): void {
    this.#socket = null;
    const retryS = this.#backoff.seconds();
    this.events.state('waiting', retryS);
    this.#startsAgain = setTimeout(() => this.start(), 1000 * retryS);
  }
}
