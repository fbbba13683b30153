import { transfersOf, type SceneBatch } from './messages';
import { RowMirror } from './row_mirror';

/** The model as it is at one moment, without its rows. */
export interface Scene {
  readonly transforms: Float32Array;
  readonly background: readonly [number, number, number];
  /** The model is all there; while it first arrives it is not. */
  readonly complete: boolean;
}

/** Gives rows to whoever draws them: everything to begin with, then what changes. */
export class Publisher {
  readonly #mirror = new RowMirror();
  #port: MessagePort | null = null;
  #begun = false;
  #standing = false;
  #scene: Scene = { transforms: new Float32Array(0), background: [0, 0, 0], complete: false };

  constructor(private readonly nowS: () => number) {}

  attach(port: MessagePort, standing: boolean): void {
    this.#port?.close();
    this.#port = port;
    this.#begun = false;
    this.#standing = standing;
    this.#begin();
  }

  publish(rows: Uint32Array, records: Uint32Array, scene: Scene): void {
    this.#scene = scene;
    const update = this.#mirror.take(rows, records, this.nowS());
    if (this.#begun) this.#send({ whole: false, update, transforms: scene.transforms.slice(), background: scene.background });
    else this.#begin();
  }

  /** To be called now and then: what has faded away becomes free. */
  tidy(): void {
    if (!this.#mirror.vanishing) return;
    const update = this.#mirror.takeVanished(this.nowS());
    if (update && this.#begun) this.#send({ whole: false, update, transforms: this.#scene.transforms.slice(), background: this.#scene.background });
  }

  bounds(): { centre: [number, number, number]; radius: number } | null {
    return this.#mirror.bounds(this.#scene.transforms);
  }

  #begin(): void {
    if (this.#standing && !this.#scene.complete) return;
    const update = this.#mirror.everything();
    if (update.rows.length === 0) return;
    this.#begun = true;
    this.#send({ whole: true, update, transforms: this.#scene.transforms.slice(), background: this.#scene.background });
  }

  #send(batch: SceneBatch): void {
    this.#port?.postMessage(batch, transfersOf(batch));
  }
}
