// What the page and its workers say to each other. The stream worker holds the model and gives its rows to whoever is at
// the other end of a port: the page, or the sort worker, which hands them on together with the order that they belong to.
import type { Vec3 } from '../math';
import type { ColorUpdate, RowUpdate, Scene, SceneTime } from '../records';
import type { Pointed } from './pick';

export interface SceneBatch {
  /** These rows are all there are: what was before is gone. */
  readonly whole: boolean;
  readonly update: RowUpdate;
  readonly colors: ColorUpdate;
  readonly scene: Scene;
  readonly time: SceneTime;
  /** Gaussians there are with it. */
  readonly shown: number;
}

/** What a page asks the streamer not to exceed. */
export interface Budget {
  readonly gaussians: number;
  /** 0: as the streamer likes. */
  readonly megabits: number;
}

/** The engine's own picture for one that was asked for. */
export interface EnginePicture {
  readonly probeId: number;
  readonly width: number;
  readonly height: number;
  /** sRGB, row 0 on top. */
  readonly rgba: Uint8ClampedArray<ArrayBuffer>;
  /** Where objects were in it, as Scene.transforms. */
  readonly transforms: Float32Array<ArrayBuffer>;
}

export type ToStreamWorker =
  | { kind: 'start'; socket: string; token: string | null; clockOriginMs: number; budget: Budget }
  /**
   * Whoever holds the other end gets everything, then what changes; whoever had a port before gets no more. If a picture
   * of `shown` Gaussians stands already nothing is sent until there is enough to replace it: see Publisher.
   */
  | { kind: 'attach'; port: MessagePort; shown: number }
  /** As many batches have been drawn. */
  | { kind: 'taken'; batches: number }
  /** view_from_world row-major 4x4, fx, fy, cx, cy, width, height. */
  | { kind: 'pose'; floats: Float32Array }
  /** Asks for the engine's own picture from there; floats as in 'pose'. It may never come. */
  | { kind: 'probe'; probeId: number; floats: Float32Array }
  /** Another Budget.megabits. */
  | { kind: 'rate'; megabits: number }
  | { kind: 'bounds' }
  /** Asks for the surface that somebody points at; `number` comes with the answer. */
  | { kind: 'pick'; number: number; at: Pointed }
  /** The page goes, and nobody is to wait for it. */
  | { kind: 'farewell' };

export type ConnectionState = 'connecting' | 'open' | 'waiting';

/** What the overlay shows of the stream. Negative: not known. */
export interface StreamFigures {
  /** When this was so, by the worker's clock. */
  readonly atMs: number;
  readonly gaussians: number;
  readonly sequence: number;
  readonly epoch: number;
  readonly sceneVersion: number;
  /** Pages of the model that have not come yet. */
  readonly missing: number;
  readonly bytes: number;
  /** Since the last scene came. */
  readonly ageMs: number;
  readonly roundTripMs: number;
}

export type FromStreamWorker =
  /** `died`: it was the worker, and not the connection. */
  | { kind: 'connection'; state: ConnectionState; retryS: number; died?: 'by itself' | 'out of memory' }
  | { kind: 'figures'; figures: StreamFigures }
  | { kind: 'bounds'; centre: [number, number, number]; radius: number }
  /** In the world, metres; null: nothing is hit. */
  | { kind: 'pick'; number: number; point: Vec3 | null }
  | { kind: 'picture'; picture: EnginePicture }
  /** The worker cannot go on: another one is needed. */
  | { kind: 'failed'; reason: string };

export type ToSortWorker =
  | { kind: 'source'; port: MessagePort }
  | { kind: 'view'; viewFromWorld: Float64Array };

/** Batches that came since the last order, and an order that knows them: to be shown in one frame. */
export interface Sorted {
  readonly batches: SceneBatch[];
  readonly order: Uint32Array;
  readonly milliseconds: number;
}

/** A worker's own scope, which the DOM's types do not have. */
export interface WorkerScope<In, Out> {
  onmessage: ((event: MessageEvent<In>) => void) | null;
  postMessage(message: Out, transfer?: Transferable[]): void;
  close(): void;
}

export const transfersOf = (batch: SceneBatch): Transferable[] => [
  batch.update.rows.buffer,
  batch.update.records.buffer,
  batch.update.fades.buffer,
  batch.colors.rows.buffer,
  batch.colors.colors.buffer,
  batch.scene.transforms.buffer,
  ...(batch.update.harmonics ? [batch.update.harmonics.values.buffer] : []),
];
