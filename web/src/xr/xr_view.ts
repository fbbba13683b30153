// WebXR's cameras as ours. Its spaces: y up, metres; its cameras look along -z with y up.
import { backwardOf, eyeOf, type Pose } from '../camera/rig';
import type { View } from '../math';

/** xr_from_world, row-major 4x4: the origin of XR's space is the eye of `pose`, level, and looks where that does. */
export function xrFromWorld(pose: Pose): Float64Array {
  const [ex, ey, ez] = eyeOf(pose);
  const [bx, , bz] = backwardOf({ ...pose, pitch: 0 });
  // Rows are XR's axes in the world: right, up, backward.
  const row = (x: number, y: number, z: number): number[] => [x, y, z, -(x * ex + y * ey + z * ez)];
  return new Float64Array([...row(bz, 0, -bx), ...row(0, 1, 0), ...row(bx, 0, bz), 0, 0, 0, 1]);
}

/** view_from_world of a camera of XR's; `transform`: where it is in XR's space. */
export function viewFromXr(transform: XRRigidTransform, fromWorld: Float64Array): Float64Array {
  const m = transform.inverse.matrix;
  const out = new Float64Array(16);
  for (let row = 0; row < 4; ++row) {
    const sign = row === 1 || row === 2 ? -1 : 1;
    for (let column = 0; column < 4; ++column) {
      for (let k = 0; k < 4; ++k) out[4 * row + column] += sign * m[4 * k + row] * fromWorld[4 * k + column];
    }
  }
  return out;
}

/** What an eye sees in so many pixels. */
export function viewOfEye(eye: XRView, fromWorld: Float64Array, width: number, height: number): View {
  const p = eye.projectionMatrix;
  return {
    viewFromWorld: viewFromXr(eye.transform, fromWorld),
    fx: (p[0] * width) / 2,
    fy: (p[5] * height) / 2,
    cx: ((1 - p[8]) * width) / 2,
    cy: ((1 + p[9]) * height) / 2,
    width,
    height,
  };
}
