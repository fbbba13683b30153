import { sharedAddress } from './camera/address';
import { kTurnSpeed } from './camera/keys';
import type { Rig } from './camera/rig';
import { Comparison } from './compare/comparison';
import { downloadModel, rightsHere, type ModelFile } from './download';
import { poseFloats, type View } from './math';
import { Picking } from './picking';
import type { EyeRenderer, Frame } from './render/renderer';
import { savePng } from './snapshot';
import type { Stage } from './stage';
import type { StreamLink } from './stream/stream_link';
import { texts } from './texts';
import { Immersion } from './xr/immersion';

/** What of the page they need. */
export interface PageActions {
  readonly view: () => View;
  readonly frame: (view: View, resolution: number, nowMs: number) => Frame;
  /** From where is looked, to those who sort and to the streamer. */
  readonly announce: (view: View, nowMs: number) => void;
  /** So fine in a headset. */
  readonly resolution: () => number;
  readonly drawn: (nowMs: number) => void;
  readonly redraw: () => void;
  readonly notice: (text: string) => void;
}

/** What a person can do with the picture besides looking at it. */
export class Extras {
  readonly comparison: Comparison;
  readonly picking: Picking;
  immersion: Immersion | null = null;
  /** A headset has been asked for, or is on. */
  #immersed = false;
  /** Whether it may compare. */
  #asking = false;

  constructor(
    private readonly stage: Stage,
    private readonly rig: Rig,
    private readonly link: StreamLink,
    private readonly access: { readonly token: string | null },
    private readonly page: PageActions,
    private readonly mip: boolean,
  ) {
    this.picking = new Picking(stage, rig, link, page.view, mip);
    this.comparison = new Comparison({
      ask: (probeId, view) => {
        const floats = poseFloats(view);
        this.link.send({ kind: 'probe', probeId, floats }, [floats.buffer]);
      },
      capture: (view, transforms) => this.stage.capture(this.#frameOfProbe(view, transforms)),
      notice: this.page.notice,
    });
  }

  #frameOfProbe(view: View, transforms: Float32Array): Frame {
    const { scene } = this.stage;
    const then = scene.transforms.slice(); // with objects that have come since
    then.set(transforms.subarray(0, then.length));
    return { view, scene: { ...scene, transforms: then }, resolution: 1, timeS: performance.now() / 1000, colorPart: 1, mip: this.mip };
  }

  async compare(): Promise<void> {
    if (this.#asking) return; // it comes on as soon as that is answered, and not on and off
    this.#asking = true;
    const here = this.comparison.on ? null : await rightsHere(this.access.token);
    this.#asking = false;
    if (here === 'silent') this.page.notice(texts.serverSilent);
    else if (here === 'refused' || (here && !here.rights.split(',').includes('probe'))) this.page.notice(texts.compareForbidden);
    else this.comparison.toggle();
  }

  async download(kind: ModelFile): Promise<void> {
    this.page.notice(texts.downloading);
    const end = await downloadModel(kind, this.access.token);
    if (end === 'refused') this.page.notice(texts.downloadForbidden);
    else if (end === 'none') this.page.notice(texts.downloadFailed);
    else if (end === 'silent') this.page.notice(texts.serverSilent);
  }

  async immerse(): Promise<void> {
    if (this.#immersed) return;
    this.#immersed = true;
    let drawing: EyeRenderer | null = null;
    const renderer = async (): Promise<EyeRenderer> => {
      drawing = await this.stage.lend();
      if (!drawing) throw new Error(texts.lacks.webgl2);
      return drawing;
    };
    try {
      this.immersion = await Immersion.start(renderer, {
        pose: () => this.rig.shown,
        steer: (motion, turn, seconds) => {
          this.rig.fly({ ...motion, level: true }, seconds);
          this.rig.look(turn * kTurnSpeed * seconds, 0);
          this.rig.jump(this.rig.goal); // a head is not to be moved on of its own accord
        },
        frame: (nowMs, head) => {
          this.stage.take(nowMs);
          this.page.announce(head, nowMs);
        },
        draw: (target, eyes, nowMs) => {
          if (!drawing || this.stage.renderer !== drawing || drawing.isLost) {
            if (this.immersion) this.page.notice(texts.immersionFailed(texts.lacks.lost));
            this.immersion?.end(); // the headset's target went with the context
            return;
          }
          drawing.drawEyes(target, eyes, this.page.frame(eyes[0].view, this.page.resolution(), nowMs));
          this.page.drawn(nowMs);
        },
        ended: () => this.#comeBack(),
      });
    } catch (error) {
      this.#comeBack();
      this.page.notice(texts.immersionFailed(error instanceof Error ? error.message : String(error)));
    }
  }

  /** From the headset, or from the way there, to the page. */
  #comeBack(): void {
    this.immersion = null;
    this.#immersed = false;
    this.stage.takeBack();
    this.page.redraw();
  }

  async saveSnapshot(): Promise<void> {
    try {
      const picture = await this.stage.capture(this.page.frame(this.page.view(), 1, performance.now()));
      if (picture) return await savePng(picture, `splatbus-${new Date().toISOString().replaceAll(':', '-').slice(0, 19)}.png`);
    } catch (error) {
      console.warn(error); // a device may be lost at any time
    }
    this.page.notice(texts.snapshotFailed);
  }

  async share(): Promise<void> {
    const address = sharedAddress(new URL(location.href), this.rig.goal);
    history.replaceState(null, '', address);
    // Without TLS a browser has no clipboard for pages, and with it a person may refuse.
    const copied = await navigator.clipboard?.writeText(address).then(() => true, () => false);
    this.page.notice(copied ? texts.shared : texts.shareByHand);
  }

  toggleFullScreen(): void {
    if (!document.fullscreenEnabled) return this.page.notice(texts.noFullScreen); // a phone's browser may have it for films alone
    void (document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen()).catch(() => this.page.notice(texts.fullScreenRefused));
  }
}
