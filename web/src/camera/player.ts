import { kTransformFloats } from '../math';
import type { Scene } from '../records';
import { poseOf, type Pose, type Rig } from './rig';

/** Goes along with the camera of the engine's player, once a person has asked for it. */
export class Player {
  following = false;

  /** False where the scene has none to go along with. */
  toggle(scene: Scene): boolean {
    const offered = scene.player > 0;
    this.following = offered && !this.following;
    return offered;
  }

  /** True if the camera has moved. One that is gone for a while may come back. */
  goAlong({ player, transforms }: Scene, rig: Rig): boolean {
    if (!this.following || player === 0) return false;
    const camera = transforms.subarray(kTransformFloats * player, kTransformFloats * (player + 1));
    if (camera.every((value) => value === 0)) return false;
    const before = rig.goal;
    rig.jump(poseOf(camera, before.distance));
    return Object.entries(rig.goal).some(([key, value]) => String(before[key as keyof Pose]) !== String(value));
  }
}
