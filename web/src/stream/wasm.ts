// splatbus.wasm as classes. What they give as typed arrays are views on the module's memory: copy what is to last beyond
// the next call.
import { instantiate, type Exports } from '../../wasm/instantiate.mjs';
import { kTransformFloats } from '../math';
import { kRecordWords, type Harmonics, type Turnover } from '../records';
import type { EnginePicture } from './messages';

export type { Exports };

/** The stream's module, or the sort's: one for each worker. */
export const loadWasm = (url: string): Promise<Exports> => instantiate(fetch(url));

/** In the order of `Stat` in web/wasm/api.h. */
export interface FollowerStats {
  readonly gaussians: number;
  readonly rowsWaiting: number;
  readonly connected: boolean;
  readonly pages: number;
  readonly missingPages: number;
  readonly sequence: number;
  readonly epoch: number;
  readonly bytesIn: number;
  readonly refused: number;
  /** Packets that did not come. */
  readonly lost: number;
  /** Pages that were asked for again. */
  readonly lacked: number;
  readonly sceneVersion: number;
  readonly sceneFrame: number;
  /** Of the engine's clock; 0: unknown. */
  readonly sceneCaptureMs: number;
  /** Of the clock that receive() was told. */
  readonly sceneArrivedMs: number;
  /** Colours are in display space, and blended there. */
  readonly radiance: boolean;
  /** The instant of the scene that the colours last taken show, as sceneCaptureMs. */
  readonly colorsMs: number;
}
const kStats = 17;
const kPoseFloats = 22;

export type ReceiveResult = 'received' | 'refused' | 'out of memory';
const kResults: readonly ReceiveResult[] = ['received', 'refused', 'out of memory'];

/** Memory of the module that grows with what is put there. */
class Scratch {
  #at = 0;
  #bytes = 0;

  constructor(private readonly wasm: Exports) {}

  put(data: Uint8Array): number {
    if (data.length > this.#bytes) {
      this.wasm.release(this.#at);
      this.#bytes = 0;
      this.#at = this.wasm.alloc(data.length);
      if (this.#at === 0) throw new Error('splatbus.wasm: no memory');
      this.#bytes = data.length;
    }
    new Uint8Array(this.wasm.memory.buffer).set(data, this.#at);
    return this.#at;
  }
}

const bytesOf = (data: ArrayBufferView): Uint8Array => new Uint8Array(data.buffer, data.byteOffset, data.byteLength);

/** A viewer's half of the stream. Times are of any steady clock, milliseconds, the same for all calls. */
export class Follower {
  readonly #session: number;
  readonly #message: Scratch;
  readonly #pose: Scratch;

  constructor(
    private readonly wasm: Exports,
    name: string,
    maxGaussians: number,
    nowMs: number,
  ) {
    this.#message = new Scratch(wasm);
    this.#pose = new Scratch(wasm);
    const bytes = new TextEncoder().encode(name);
    this.#session = wasm.follower_new(this.#message.put(bytes), bytes.length, maxGaussians, nowMs);
  }

  /** Rate below which the streamer is asked to stay; 0: as it likes. */
  setMaxKbps(kbps: number): void {
    this.wasm.set_max_kbps(this.#session, kbps);
  }

  /** The WebSocket is a new one. */
  restart(): void {
    this.wasm.follower_restart(this.#session);
  }

  /** One binary message of the WebSocket. */
  receive(message: ArrayBuffer, nowMs: number): ReceiveResult {
    const at = this.#message.put(new Uint8Array(message));
    return kResults[this.wasm.receive(this.#session, at, message.byteLength, nowMs)] ?? 'refused';
  }

  /** Why the last message was refused that was. */
  get error(): string {
    const bytes = this.wasm.error_bytes(this.#session);
    return new TextDecoder().decode(new Uint8Array(this.wasm.memory.buffer, this.wasm.error_text(this.#session), bytes));
  }

  /** The next message to send, null when nothing is due; a copy. */
  nextOutgoing(nowMs: number): Uint8Array<ArrayBuffer> | null {
    const bytes = this.wasm.next_outgoing(this.#session, nowMs);
    return bytes === 0 ? null : this.#outgoing(bytes);
  }

  /** The last message, before the page goes; a copy. */
  farewell(): Uint8Array<ArrayBuffer> {
    return this.#outgoing(this.wasm.farewell(this.#session));
  }

  /** view_from_world row-major 4x4, fx, fy, cx, cy, width, height; false for what is no camera. */
  setPose(floats: Float32Array): boolean {
    if (floats.length !== kPoseFloats) throw new Error(`a pose of ${floats.length} numbers`);
    return this.wasm.set_pose(this.#session, this.#pose.put(bytesOf(floats))) !== 0;
  }

  /** Asks for the engine's own picture from there, as setPose(); false for what is no camera. */
  askPicture(probeId: number, floats: Float32Array): boolean {
    return this.wasm.ask_picture(this.#session, probeId, this.#pose.put(bytesOf(floats))) !== 0;
  }

  /** The oldest picture that has come; a copy. */
  takePicture(): EnginePicture | null {
    if (this.wasm.take_picture(this.#session) === 0) return null;
    const { buffer } = this.wasm.memory;
    const [probeId, width, height] = new Float64Array(buffer, this.wasm.picture_info_ptr(this.#session), 3);
    const rgba = new Uint8ClampedArray(buffer, this.wasm.picture_ptr(this.#session), 4 * width * height).slice();
    const n = kTransformFloats * this.wasm.transform_count(this.#session);
    const transforms = new Float32Array(buffer, this.wasm.picture_transforms_ptr(this.#session), n).slice();
    return { probeId, width, height, rgba, transforms };
  }

  /** Rows that have changed, [n], and what is in them now, [n][8]. */
  takeChanges(maxRows: number): { rows: Uint32Array; records: Uint32Array; turnover: Turnover; harmonics?: Harmonics } {
    const n = this.wasm.take_changes(this.#session, maxRows);
    const rows = this.#words(this.wasm.changed_rows_ptr(this.#session), n);
    const records = this.#words(this.wasm.changed_records_ptr(this.#session), kRecordWords * n);
    const turnover = {
      origins: this.#words(this.wasm.changed_origins_ptr(this.#session), n),
      left: new Uint8Array(this.wasm.memory.buffer, this.wasm.changed_left_ptr(this.#session), n),
    };
    const words = this.wasm.harmonic_words(this.#session);
    if (words === 0) return { rows, records, turnover };
    return { rows, records, turnover, harmonics: { words, values: this.#words(this.wasm.changed_harmonics_ptr(this.#session), words * n) } };
  }

  /** Rows of which the colour alone has changed. */
  takeColors(maxRows: number): { rows: Uint32Array; colors: Uint32Array } {
    const n = this.wasm.take_colors(this.#session, maxRows);
    const rows = this.#words(this.wasm.changed_rows_ptr(this.#session), n);
    return { rows, colors: this.#words(this.wasm.changed_colors_ptr(this.#session), n) };
  }

  /** All rows are given again. */
  forgetTaken(): void {
    this.wasm.forget_taken(this.#session);
  }

  get rowCapacity(): number {
    return this.wasm.row_capacity(this.#session);
  }

  /** world_from_object by index, [n][3][4] row-major. */
  get transforms(): Float32Array {
    const n = this.wasm.transform_count(this.#session);
    return new Float32Array(this.wasm.memory.buffer, this.wasm.transforms_ptr(this.#session), kTransformFloats * n);
  }

  /** 0: there is none. To the last column of its transform the eye's position is to be added. */
  get farFieldIndex(): number {
    return this.wasm.far_field_index(this.#session);
  }

  /** Of the camera of the engine's player, whose transform is world_from_camera. 0: there is none. */
  get playerIndex(): number {
    return this.wasm.player_index(this.#session);
  }

  /** Linear. */
  get background(): [number, number, number] {
    const at = this.wasm.background_ptr(this.#session);
    const [r, g, b] = new Float32Array(this.wasm.memory.buffer, at, 3);
    return [r ?? 0, g ?? 0, b ?? 0];
  }

  get sceneVersion(): number {
    return this.wasm.scene_version(this.#session);
  }

  get stats(): FollowerStats {
    const at = this.wasm.stats_ptr(this.#session);
    const s = new Float64Array(this.wasm.memory.buffer, at, kStats);
    const stat = (index: number): number => s[index] ?? 0;
    return {
      gaussians: stat(0),
      rowsWaiting: stat(1),
      connected: stat(2) === 1,
      pages: stat(3),
      missingPages: stat(4),
      sequence: stat(5),
      epoch: stat(6),
      bytesIn: stat(7),
      refused: stat(8),
      lost: stat(9),
      lacked: stat(10),
      sceneVersion: stat(11),
      sceneFrame: stat(12),
      sceneCaptureMs: stat(13),
      sceneArrivedMs: stat(14),
      radiance: stat(15) === 1,
      colorsMs: stat(16),
    };
  }

  /** Of all integers that are held after the last message: for tests. */
  get heldHash(): bigint {
    const [low, high] = this.#words(this.wasm.held_hash_ptr(this.#session), 2);
    return (BigInt(high) << 32n) | BigInt(low);
  }

  #words(at: number, count: number): Uint32Array {
    return new Uint32Array(this.wasm.memory.buffer, at, count);
  }

  #outgoing(bytes: number): Uint8Array<ArrayBuffer> {
    return new Uint8Array(this.wasm.memory.buffer, this.wasm.outgoing_ptr(this.#session), bytes).slice();
  }
}

/** The order in which rows are drawn. */
export class Sorter {
  readonly #sorter: number;
  readonly #rows: Scratch;
  readonly #records: Scratch;

  constructor(private readonly wasm: Exports) {
    this.#sorter = wasm.sorter_new();
    this.#rows = new Scratch(wasm);
    this.#records = new Scratch(wasm);
  }

  /** What Follower.takeChanges() gave; `capacity` is above every row. */
  update(capacity: number, rows: Uint32Array, records: Uint32Array): void {
    this.wasm.sorter_rows(this.#sorter, capacity);
    const rowsAt = this.#rows.put(bytesOf(rows));
    const recordsAt = this.#records.put(bytesOf(records));
    if (this.wasm.sorter_update(this.#sorter, rowsAt, recordsAt, rows.length) !== 0) {
      throw new Error(`a row beyond ${capacity}`);
    }
  }

  setTransforms(transforms: Float32Array, farFieldIndex: number): void {
    const at = this.#records.put(bytesOf(transforms));
    this.wasm.sorter_transforms(this.#sorter, at, transforms.length / kTransformFloats, farFieldIndex);
  }

  /** Rows before the camera, farthest first; view_from_world row-major 4x4. */
  sort(viewFromWorld: Float32Array): Uint32Array {
    const n = this.wasm.sort(this.#sorter, this.#rows.put(bytesOf(viewFromWorld)));
    return new Uint32Array(this.wasm.memory.buffer, this.wasm.order_ptr(this.#sorter), n);
  }
}
