// The surface under a pixel: what double-clicks ask for.
import { cameraFromObjects, kTransformFloats, type Vec3, type View } from '../math';
import { kRecordWords, objectOf, opacityOf, type Scene } from '../records';
import { kNoFade, tangentLimits } from '../render/renderer';

/** Where somebody points, in what they see. */
export interface Pointed {
  readonly view: View;
  /** Of the view's pixels, whose centres are at +0.5. */
  readonly x: number;
  readonly y: number;
  /** With objects where they are shown. */
  readonly scene: Scene;
  /** As Frame's. */
  readonly mip: boolean;
}

/** As the renderers have them. */
const kNear = 0.05;
const kBlur = 0.3;
const kAlphaMin = 1 / 255;
const kAlphaMax = 0.999;
/** So many standard deviations from its middle a Gaussian of opacity 1 falls below kAlphaMin. */
const kReach = Math.sqrt(2 * Math.log(255));
/** What lets no more than that through is a surface. */
const kThrough = 0.5;

const kStepsALog = 1024;
const kRadiansAStep = Math.PI / 32767;

const low = (word: number): number => (word << 16) >> 16;
const high = (word: number): number => word >> 16;

/** Columns of the rotation by a vector, as nine numbers by rows. */
function rotationOf(x: number, y: number, z: number): number[] {
  const angle = Math.hypot(x, y, z);
  const part = angle > 1e-6 ? Math.sin(angle / 2) / angle : 0.5;
  const [i, j, k, w] = [part * x, part * y, part * z, Math.cos(angle / 2)];
  return [
    1 - 2 * (j * j + k * k), 2 * (i * j - w * k), 2 * (i * k + w * j),
    2 * (i * j + w * k), 1 - 2 * (i * i + k * k), 2 * (j * k - w * i),
    2 * (i * k - w * j), 2 * (j * k + w * i), 1 - 2 * (i * i + j * j),
  ];
}

interface Hit {
  /** Of the mean, by which pictures are in order. */
  readonly z: number;
  readonly alpha: number;
  /** Where along the ray it is densest, metres along the view's axis. */
  readonly depth: number;
}

/** Rays of one pixel against one Gaussian after the other. */
class Ray {
  readonly #x: number;
  readonly #y: number;
  readonly #cameraFromObject: Float32Array;
  /** Of each object, how much larger it makes things at most. */
  readonly #growth: Float32Array;
  readonly #limits: readonly [number, number, number, number];

  constructor(private readonly at: Pointed) {
    const { view, scene } = at;
    this.#x = (at.x - view.cx) / view.fx;
    this.#y = (at.y - view.cy) / view.fy;
    this.#limits = tangentLimits(view);
    const matrices = (this.#cameraFromObject = new Float32Array(scene.transforms.length));
    cameraFromObjects(view, scene.transforms, scene.farField, matrices);
    this.#growth = new Float32Array(matrices.length / kTransformFloats).map((_, object) => {
      const m = matrices.subarray(kTransformFloats * object);
      return Math.hypot(m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]);
    });
  }

  /** Null where the Gaussian of that row adds nothing to the pixel, or is of the far field, which is no surface. */
  meet(records: Uint32Array, means: Float32Array, row: number): Hit | null {
    const object = objectOf(records, row);
    const { farField } = this.at.scene;
    if (farField !== 0 && object === farField) return null;
    const { fx, fy } = this.at.view;
    const m = this.#cameraFromObject;
    const o = kTransformFloats * object;
    const r = kRecordWords * row;
    const [mx, my, mz] = [means[r], means[r + 1], means[r + 2]];
    const z = m[o + 8] * mx + m[o + 9] * my + m[o + 10] * mz + m[o + 11];
    if (!(z > kNear)) return null; // nor is it a number where the scene does not know the object yet
    const tx = (m[o] * mx + m[o + 1] * my + m[o + 2] * mz + m[o + 3]) / z;
    const ty = (m[o + 4] * mx + m[o + 5] * my + m[o + 6] * mz + m[o + 7]) / z;
    const dx = fx * (this.#x - tx);
    const dy = fy * (this.#y - ty);

    // Nearly all are too far off to reach the pixel, whatever they are like.
    const logs = [low(records[r + 3]), high(records[r + 3]), low(records[r + 4])];
    const largest = this.#growth[object] * Math.exp(Math.max(logs[0], logs[1], logs[2]) / kStepsALog);
    const spread = (Math.max(fx, fy) / z) * largest;
    const [left, right, top, bottom] = this.#limits;
    const cx = Math.min(Math.max(tx, left), right);
    const cy = Math.min(Math.max(ty, top), bottom);
    if (dx * dx + dy * dy > kReach * kReach * (spread * spread * (1 + cx * cx + cy * cy) + kBlur)) return null;

    const size = logs.map((log) => Math.exp(log / kStepsALog));
    const turn = rotationOf(kRadiansAStep * high(records[r + 4]), kRadiansAStep * low(records[r + 5]), kRadiansAStep * high(records[r + 5]));
    // camera_from_object R S: what makes a ball of standard deviation 1 the Gaussian.
    const shape = [0, 1, 2].map((i) =>
      [0, 1, 2].map((k) => (m[o + 4 * i] * turn[k] + m[o + 4 * i + 1] * turn[3 + k] + m[o + 4 * i + 2] * turn[6 + k]) * size[k]),
    );
    const alpha = this.#alpha(shape, cx, cy, z, dx, dy, opacityOf(records, row) / 255);
    if (alpha < kAlphaMin) return null;
    return { z, alpha, depth: this.#depth(shape, tx * z, ty * z, z, largest) };
  }

  /** As a picture has it there. */
  #alpha(shape: number[][], tx: number, ty: number, z: number, dx: number, dy: number, opacity: number): number {
    const { fx, fy } = this.at.view;
    const across = [0, 1, 2].map((k) => (fx / z) * (shape[0][k] - tx * shape[2][k]));
    const down = [0, 1, 2].map((k) => (fy / z) * (shape[1][k] - ty * shape[2][k]));
    const dot = (u: number[], v: number[]): number => u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
    const [a, b, c] = [dot(across, across), dot(across, down), dot(down, down)];
    const sharp = Math.max(a * c - b * b, 0);
    const blurred = sharp + kBlur * (a + c) + kBlur * kBlur;
    const middle = this.at.mip ? opacity * Math.sqrt(sharp / blurred) : opacity;
    const distance = ((c + kBlur) * dx * dx - 2 * b * dx * dy + (a + kBlur) * dy * dy) / blurred;
    return Math.min(kAlphaMax, middle * Math.exp(-distance / 2));
  }

  /** The ray's point that is nearest to the mean in standard deviations; near to it where the ray passes it by. */
  #depth(shape: number[][], x: number, y: number, z: number, largest: number): number {
    // Rows of the inverse but for the determinant, so that what is flat does not divide by nothing.
    const column = (k: number): Vec3 => [shape[0][k], shape[1][k], shape[2][k]];
    const normals = [0, 1, 2].map((k): Vec3 => {
      const [u, v] = [column((k + 1) % 3), column((k + 2) % 3)];
      return [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    });
    let [along, squared] = [0, 0];
    for (const [nx, ny, nz] of normals) {
      const ray = nx * this.#x + ny * this.#y + nz;
      along += ray * (nx * x + ny * y + nz * z);
      squared += ray * ray;
    }
    const depth = squared > 0 ? along / squared : z;
    return Math.max(Math.min(Math.max(depth, z - kReach * largest), z + kReach * largest), kNear);
  }

  /** In the world. */
  point(depth: number): Vec3 {
    const v = this.at.view.viewFromWorld;
    const from = [this.#x * depth - v[3], this.#y * depth - v[7], depth - v[11]];
    const world = (k: number): number => v[k] * from[0] + v[4 + k] * from[1] + v[8 + k] * from[2];
    return [world(0), world(1), world(2)];
  }
}

/**
 * Where what is before that pixel comes to hide half of what is behind it, in the world, metres; null where it never does. Rows as
 * RowMirror has them: those that vanish are no surface any more.
 */
export function pick(records: Uint32Array, fades: Float32Array, used: number, at: Pointed): Vec3 | null {
  const means = new Float32Array(records.buffer, records.byteOffset, records.length);
  const ray = new Ray(at);
  const hits: Hit[] = [];
  for (let row = 0; row < used; ++row) {
    if (opacityOf(records, row) === 0 || fades[row] < kNoFade) continue;
    const hit = ray.meet(records, means, row);
    if (hit) hits.push(hit);
  }
  hits.sort((a, b) => a.z - b.z);
  let through = 1;
  for (const { alpha, depth } of hits) {
    through *= 1 - alpha;
    if (through <= kThrough) return ray.point(depth);
  }
  return null;
}
