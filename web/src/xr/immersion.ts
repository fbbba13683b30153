import type { Motion, Pose } from '../camera/rig';
import type { View } from '../math';
import type { Eye, EyeRenderer } from '../render/renderer';
import { viewFromXr, viewOfEye, xrFromWorld } from './xr_view';

const kDead = 0.15;

export interface ImmersionActions {
  /** Where the person stands in the world. */
  readonly pose: () => Pose;
  /** A step by the controllers; turn to the right in [-1, 1]. */
  readonly steer: (motion: Motion, turn: number, seconds: number) => void;
  /** Between poses and pictures: `head` is what is to be sorted for and told to the streamer. */
  readonly frame: (nowMs: number, head: View) => void;
  readonly draw: (target: WebGLFramebuffer | null, eyes: readonly Eye[], nowMs: number) => void;
  readonly ended: () => void;
}

/** Whether there is a headset that can be asked. */
export async function canImmerse(): Promise<boolean> {
  return (await navigator.xr?.isSessionSupported('immersive-vr').catch(() => false)) ?? false;
}

/** A session of WebXR: both eyes through WebGL2, in the order of one sort. */
export class Immersion {
  #lastMs = 0;

  private constructor(
    private readonly session: XRSession,
    private readonly layer: XRWebGLLayer,
    private readonly space: XRReferenceSpace,
    private readonly actions: ImmersionActions,
  ) {
    session.addEventListener('end', () => actions.ended());
    session.requestAnimationFrame((nowMs, frame) => this.#frame(nowMs, frame));
  }

  /** To be called by a person's click. `renderer` is asked for once the session is granted. */
  static async start(renderer: () => Promise<EyeRenderer>, actions: ImmersionActions): Promise<Immersion> {
    if (!navigator.xr) throw new Error('no WebXR');
    const session = await navigator.xr.requestSession('immersive-vr');
    try {
      const gl = await (await renderer()).forXr();
      const layer = new XRWebGLLayer(session, gl, { antialias: false, depth: false });
      await session.updateRenderState({ baseLayer: layer });
      return new Immersion(session, layer, await session.requestReferenceSpace('local'), actions);
    } catch (error) {
      await session.end().catch(() => {});
      throw error;
    }
  }

  end(): void {
    void this.session.end().catch(() => {});
  }

  #frame(nowMs: number, frame: XRFrame): void {
    this.session.requestAnimationFrame((next, of) => this.#frame(next, of));
    this.#steer(this.#lastMs > 0 ? (nowMs - this.#lastMs) / 1000 : 0);
    this.#lastMs = nowMs;
    const pose = frame.getViewerPose(this.space);
    if (!pose) return; // not tracked just now
    const fromWorld = xrFromWorld(this.actions.pose());
    const eyes = pose.views.flatMap((view): Eye[] => {
      const port = this.layer.getViewport(view);
      return port ? [{ view: viewOfEye(view, fromWorld, port.width, port.height), x: port.x, y: port.y }] : [];
    });
    if (eyes.length === 0) return;
    this.actions.frame(nowMs, { ...eyes[0].view, viewFromWorld: viewFromXr(pose.transform, fromWorld) });
    this.actions.draw(this.layer.framebuffer, eyes, nowMs);
  }

  /** The left stick moves, the right one turns; its other axis rises and sinks. */
  #steer(seconds: number): void {
    const sticks = { left: [0, 0], right: [0, 0] };
    let fast = false;
    for (const { handedness, gamepad } of this.session.inputSources) {
      if (!gamepad || handedness === 'none') continue;
      const axis = (index: number): number => (Math.abs(gamepad.axes[index] ?? 0) < kDead ? 0 : gamepad.axes[index]);
      sticks[handedness] = [axis(2), axis(3)];
      fast ||= (gamepad.buttons[1]?.value ?? 0) > 0.5;
    }
    const motion = { right: sticks.left[0], ahead: -sticks.left[1], up: -sticks.right[1], fast };
    if ([...sticks.left, ...sticks.right].some((value) => value !== 0)) this.actions.steer(motion, sticks.right[0], seconds);
  }
}
