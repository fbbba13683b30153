// Objects on their way from one transform to another: they turn, where a straight way would make them smaller halfway.
import { cross, dot, kTransformFloats, length, mix, scale, type Vec3 } from '../math';

/** x, y, z, w; of unit length. */
type Quaternion = readonly number[];

/** Of a transform but for where it is: what it is turned by, and how long its axes are. */
interface Turned {
  readonly rotation: Quaternion;
  readonly sizes: Vec3;
}

/** Cosines between axes that rounding explains. */
const kSquare = 1e-3;
/** An object gets no smaller than this part of the later one, however long it went on as it shrank. */
const kLeastSize = 0.5;
/** Two rotations whose cosine is less than this off 1 are mixed: the sines by which the arc is divided are too small. */
const kSameRotation = 1e-9;

/**
 * Sets the transform at `at` of `out` to what is that part of the way between those of `from` and `to`, beyond 1 on along the
 * same way: by the shorter turn. One that is sheared, mirrored or flat has no turn, and every number of it goes straight.
 */
export function mixTransform(from: Float32Array, to: Float32Array, at: number, part: number, out: Float32Array): void {
  const straight = (k: number): number => mix(from[k], to[k], part);
  if (isSame(from, to, at)) {
    for (let k = at; k < at + kTransformFloats; ++k) out[k] = k % 4 === 3 ? straight(k) : to[k]; // not rounded anew
    return;
  }
  const [before, after] = [turnedOf(from, at), turnedOf(to, at)];
  for (let k = at; k < at + kTransformFloats; ++k) out[k] = straight(k);
  if (!before || !after) return;
  axesOf(slerp(before.rotation, after.rotation, part)).forEach((axis, column) => {
    const size = Math.max(mix(before.sizes[column], after.sizes[column], part), kLeastSize * after.sizes[column]);
    axis.forEach((value, row) => (out[at + 4 * row + column] = size * value));
  });
}

/** But for where they are. */
function isSame(a: Float32Array, b: Float32Array, at: number): boolean {
  for (let k = at; k < at + kTransformFloats; ++k) if (k % 4 !== 3 && a[k] !== b[k]) return false;
  return true;
}

/** Null for what is not a turn and a size along each axis. */
function turnedOf(transforms: Float32Array, at: number): Turned | null {
  const column = (k: number): Vec3 => [transforms[at + k], transforms[at + 4 + k], transforms[at + 8 + k]];
  const columns = [column(0), column(1), column(2)] as const;
  const sizes: Vec3 = [length(columns[0]), length(columns[1]), length(columns[2])];
  if (!sizes.every((size) => size > 0)) return null;
  const [x, y, z] = columns.map((axis, k) => scale(axis, 1 / sizes[k]));
  if ([dot(x, y), dot(y, z), dot(z, x)].some((cosine) => Math.abs(cosine) > kSquare)) return null;
  if (dot(cross(x, y), z) < 0) return null;
  return { rotation: quaternionOf(x, y, z), sizes };
}

/** Of the rotation with these columns. */
function quaternionOf(x: Vec3, y: Vec3, z: Vec3): Quaternion {
  // Four times every product of two of its parts: any row is the quaternion but for its length, and of the longest the least is lost.
  const [xy, xz, yz] = [y[0] + x[1], z[0] + x[2], z[1] + y[2]];
  const [xw, yw, zw] = [y[2] - z[1], z[0] - x[2], x[1] - y[0]];
  const rows = [
    [1 + x[0] - y[1] - z[2], xy, xz, xw],
    [xy, 1 - x[0] + y[1] - z[2], yz, yw],
    [xz, yz, 1 - x[0] - y[1] + z[2], zw],
    [xw, yw, zw, 1 + x[0] + y[1] + z[2]],
  ];
  const squares = rows.map((row, k) => row[k]);
  return unit(rows[squares.indexOf(Math.max(...squares))]);
}

function axesOf([x, y, z, w]: Quaternion): readonly [Vec3, Vec3, Vec3] {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)],
    [2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)],
    [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)],
  ];
}

function unit(q: Quaternion): Quaternion {
  const norm = Math.hypot(...q);
  return q.map((value) => value / norm);
}

/** At an even pace, the shorter way: a quaternion and its negative are the same rotation. */
function slerp(from: Quaternion, to: Quaternion, part: number): Quaternion {
  const cosine = from.reduce((sum, value, k) => sum + value * to[k], 0);
  const near = to.map((value) => (cosine < 0 ? -value : value));
  const arc = Math.acos(Math.min(Math.abs(cosine), 1));
  const [a, b] = 1 - Math.abs(cosine) < kSameRotation ? [1 - part, part] : [Math.sin((1 - part) * arc), Math.sin(part * arc)];
  return unit(from.map((value, k) => a * value + b * near[k]));
}
