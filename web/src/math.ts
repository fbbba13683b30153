// Small vectors, rotations and 3x4 matrices. World: right-handed, metres, y up. Camera: x right, y down, z forward.
export type Vec3 = readonly [number, number, number];

export const add = (a: Vec3, b: Vec3): Vec3 => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const sub = (a: Vec3, b: Vec3): Vec3 => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const scale = (a: Vec3, s: number): Vec3 => [a[0] * s, a[1] * s, a[2] * s];
export const dot = (a: Vec3, b: Vec3): number => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const length = (a: Vec3): number => Math.hypot(a[0], a[1], a[2]);
export const cross = (a: Vec3, b: Vec3): Vec3 => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];
export const mix = (a: number, b: number, part: number): number => a + (b - a) * part;
export const clamp = (x: number, low: number, high: number): number => Math.min(Math.max(x, low), high);

/** A pinhole: view_from_world is row-major 4x4; fx, fy, cx, cy in pixels, pixel centres at +0.5. */
export interface View {
  readonly viewFromWorld: Float64Array;
  readonly fx: number;
  readonly fy: number;
  readonly cx: number;
  readonly cy: number;
  readonly width: number;
  readonly height: number;
}

/** view_from_world of an eye that looks along `forward` (unit), world y up. */
export function viewFromWorld(eye: Vec3, forward: Vec3): Float64Array {
  const level = cross(forward, [0, 1, 0]);
  const right = scale(level, 1 / Math.max(length(level), 1e-12));
  const down = cross(forward, right);
  const row = (axis: Vec3): number[] => [axis[0], axis[1], axis[2], -dot(axis, eye)];
  return new Float64Array([...row(right), ...row(down), ...row(forward), 0, 0, 0, 1]);
}

/** As the stream worker is told: view_from_world, fx, fy, cx, cy, width, height. */
export const poseFloats = ({ viewFromWorld, fx, fy, cx, cy, width, height }: View): Float32Array<ArrayBuffer> =>
  new Float32Array([...viewFromWorld, fx, fy, cx, cy, width, height]);

/** The same picture in another number of pixels. */
export function scaledView(view: View, width: number, height: number): View {
  const x = width / view.width;
  const y = height / view.height;
  return { ...view, fx: view.fx * x, fy: view.fy * y, cx: view.cx * x, cy: view.cy * y, width, height };
}

/** Floats of a world_from_object, row-major 3x4. */
export const kTransformFloats = 12;

function isHidden(transforms: Float32Array, at: number): boolean {
  for (let k = 0; k < kTransformFloats; ++k) if (transforms[at + k] !== 0) return false;
  return true;
}

/**
 * camera_from_object of every transform, [count][12], in double precision until the end. That of index `farField`, if it
 * is not 0, goes with the eye.
 */
export function cameraFromObjects(view: View, transforms: Float32Array, farField: number, out: Float32Array): void {
  const v = view.viewFromWorld;
  for (let at = 0; at < transforms.length; at += kTransformFloats) {
    if (isHidden(transforms, at)) {
      out.fill(0, at, at + kTransformFloats); // at the eye, where nothing is seen
      continue;
    }
    const fixed = farField === 0 || at !== farField * kTransformFloats;
    for (let row = 0; row < 3; ++row) {
      for (let column = 0; column < 4; ++column) {
        let sum = column === 3 && fixed ? v[4 * row + 3] : 0;
        for (let k = 0; k < 3; ++k) sum += v[4 * row + k] * transforms[at + 4 * k + column];
        out[at + 4 * row + column] = sum;
      }
    }
  }
}
