import { kNoScene, type ColorUpdate, type RowUpdate, type Scene, type SceneTime } from '../records';
import { kNoFade } from '../render/renderer';
import { transfersOf } from './messages';
import { RowMirror, type ChangedRows } from './row_mirror';

const noColors = (): ColorUpdate => ({ rows: new Uint32Array(0), colors: new Uint32Array(0) });

const sameScene = (a: Scene, b: Scene): boolean =>
  a.farField === b.farField &&
  a.player === b.player &&
  a.displaySpace === b.displaySpace &&
  a.background.every((value, k) => value === b.background[k]) &&
  a.transforms.length === b.transforms.length &&
  a.transforms.every((value, i) => value === b.transforms[i]);

/** Batches that may be on their way: one is drawn while the next is sorted. */
const kMostUnderWay = 2;

/** Gives rows to whoever draws them: everything to begin with, then what changes. */
export class Publisher {
  readonly #mirror = new RowMirror();
  #port: MessagePort | null = null;
  #begun = false;
  #underWay = 0;
  #standing = false;
  #scene = kNoScene;
  #time: SceneTime = { captureMs: 0, arrivedMs: 0, colorsMs: 0 };
  #complete = false;

  /** `nowS`: the clock of RowUpdate.fades. */
  constructor(private readonly nowS: () => number) {}

  attach(port: MessagePort, standing: boolean): void {
    this.#port?.close();
    this.#port = port;
    this.#begun = false;
    this.#underWay = 0;
    this.#standing = standing;
    this.#begin();
  }

  /** Whoever draws has taken a batch. */
  taken(): void {
    this.#underWay = Math.max(0, this.#underWay - 1);
  }

  /** False while who draws has enough to do: what changes meanwhile is better published together. */
  get ready(): boolean {
    return this.#underWay < kMostUnderWay;
  }

  /** What has changed; `complete` when the model is all there, which it is not while it first arrives. */
  publish(changed: ChangedRows, colors: ColorUpdate, scene: Scene, time: SceneTime, complete: boolean): void {
    const same = sameScene(scene, this.#scene);
    this.#scene = scene;
    this.#time = time;
    this.#complete = complete;
    const update = this.#mirror.take(changed, this.nowS());
    this.#mirror.recolor(colors);
    if (!this.#begun) this.#begin();
    else if (!same || changed.rows.length > 0 || colors.rows.length > 0) this.#send(false, update, colors);
  }

  /** To be called now and then: what has faded away becomes free. */
  tidy(): void {
    if (!this.ready) return;
    const update = this.#mirror.takeVanished(this.nowS());
    if (update && this.#begun) this.#send(false, update, noColors());
  }

  bounds(): { centre: [number, number, number]; radius: number } | null {
    return this.#mirror.bounds(this.#scene);
  }

  #begin(): void {
    if (!this.#port || (this.#standing && !this.#complete)) return;
    const update = this.#mirror.everything();
    if (update.rows.length === 0) return;
    if (this.#standing) update.fades.fill(kNoFade); // it takes the place of one that is seen
    this.#begun = true;
    this.#send(true, update, noColors());
  }

  #send(whole: boolean, update: RowUpdate, colors: ColorUpdate): void {
    ++this.#underWay;
    const copied = { rows: colors.rows.slice(), colors: colors.colors.slice() };
    const scene = { ...this.#scene, transforms: this.#scene.transforms.slice() };
    const batch = { whole, update, colors: copied, scene, time: this.#time };
    this.#port?.postMessage(batch, transfersOf(batch));
  }
}
