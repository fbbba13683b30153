import { kNoScene, type ColorUpdate, type RowUpdate, type Scene, type SceneTime } from '../records';
import type { Vec3 } from '../math';
import { kNoFade } from '../render/renderer';
import { transfersOf } from './messages';
import type { Pointed } from './pick';
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
/** Of what a picture shows that stands, or of what there is room for: what has as much may take its place. */
const kEnough = 0.9;
/** Longer than this nothing that is there waits to take the place of a picture that stands. */
const kPatienceS = 5;

/** Gives rows to whoever draws them: everything to begin with, then what changes. */
export class Publisher {
  readonly #mirror = new RowMirror();
  #port: MessagePort | null = null;
  #begun = false;
  #underWay = 0;
  /** Gaussians of the picture that stands. */
  #shown = 0;
  /** Since when there is something to take its place. */
  #heldS: number | null = null;
  #scene = kNoScene;
  #time: SceneTime = { captureMs: 0, arrivedMs: 0, colorsMs: 0 };
  #complete = false;

  /** `nowS`: the clock of RowUpdate.fades; `budget`: Gaussians that are asked for at most. */
  constructor(
    private readonly nowS: () => number,
    private readonly budget: number,
  ) {}

  /** `shown`: Gaussians of the picture that stands; 0: there is none. */
  attach(port: MessagePort, shown: number): void {
    this.#port?.close();
    this.#port = port;
    this.#begun = false;
    this.#underWay = 0;
    this.#shown = shown;
    this.#heldS = null;
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

  /** To be called now and then: what has faded away becomes free, and nothing waits for ever. */
  tidy(): void {
    if (!this.ready) return;
    if (!this.#begun) this.#begin();
    const update = this.#mirror.takeVanished(this.nowS());
    if (update && this.#begun) this.#send(false, update, noColors());
  }

  bounds(): { centre: [number, number, number]; radius: number } | null {
    return this.#mirror.bounds(this.#scene);
  }

  pick(at: Pointed): Vec3 | null {
    return this.#mirror.pick(at);
  }

  /** Of a model beyond the budget the rest never comes. */
  #replaces(): boolean {
    const held = this.#mirror.count;
    if (held === 0) return this.#shown === 0;
    this.#heldS ??= this.nowS();
    return this.#complete || held >= kEnough * Math.min(this.budget, this.#shown) || this.nowS() - this.#heldS >= kPatienceS;
  }

  #begin(): void {
    if (!this.#port || !this.#replaces()) return;
    const update = this.#mirror.everything();
    if (update.rows.length === 0) return;
    // It takes the place of one that is seen.
    if (this.#shown > 0) update.fades.forEach((fade, index) => (update.fades[index] = Math.min(fade, kNoFade)));
    this.#begun = true;
    this.#send(true, update, noColors());
  }

  #send(whole: boolean, update: RowUpdate, colors: ColorUpdate): void {
    ++this.#underWay;
    const copied = { rows: colors.rows.slice(), colors: colors.colors.slice() };
    const scene = { ...this.#scene, transforms: this.#scene.transforms.slice() };
    const batch = { whole, update, colors: copied, scene, time: this.#time, shown: this.#mirror.count };
    this.#port?.postMessage(batch, transfersOf(batch));
  }
}
