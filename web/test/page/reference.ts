// The picture's definition in double precision, pixel by pixel: an independent truth for the renderers.
import type { View } from '../../src/math';
import type { Gaussian, SyntheticScene } from './synthetic_scene';

type Row = [number, number, number];
const dot3 = (a: Row, b: Row): number => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

/** Rodrigues' formula. */
function rotationMatrix(vector: Row): [Row, Row, Row] {
  const angle = Math.hypot(...vector);
  const [x, y, z] = angle > 0 ? (vector.map((v) => v / angle) as Row) : [1, 0, 0];
  const c = Math.cos(angle);
  const s = Math.sin(angle);
  const t = 1 - c;
  return [
    [t * x * x + c, t * x * y - s * z, t * x * z + s * y],
    [t * x * y + s * z, t * y * y + c, t * y * z - s * x],
    [t * x * z - s * y, t * y * z + s * x, t * z * z + c],
  ];
}

interface Splat {
  x: number;
  y: number;
  z: number;
  inverse: [number, number, number];
  reach: [number, number];
  alpha: number;
  color: Row;
}

function project(gaussian: Gaussian, transforms: Float32Array, view: View, mip: boolean): Splat | null {
  const at = 12 * gaussian.object;
  if (transforms.subarray(at, at + 12).every((value) => value === 0)) return null; // hidden
  const w: Row[] = [0, 1, 2].map((r) => [...transforms.subarray(at + 4 * r, at + 4 * r + 3)] as Row);
  const world = [0, 1, 2].map((r) => dot3(w[r], gaussian.mean) + transforms[at + 4 * r + 3]) as Row;
  const v: Row[] = [0, 1, 2].map((r) => [...view.viewFromWorld.subarray(4 * r, 4 * r + 3)] as Row);
  const camera = [0, 1, 2].map((r) => dot3(v[r], world) + view.viewFromWorld[4 * r + 3]) as Row;
  const z = camera[2];
  if (z <= 0.05) return null;
  const limit = (size: number, centre: number, focal: number, tangent: number): number => {
    const beyond = 0.3 * 0.5 * (size / focal);
    return Math.min(Math.max(tangent, -centre / focal - beyond), (size - centre) / focal + beyond);
  };
  const tx = limit(view.width, view.cx, view.fx, camera[0] / z);
  const ty = limit(view.height, view.cy, view.fy, camera[1] / z);
  // J V W R S, row by row.
  const rotation = rotationMatrix(gaussian.rotation);
  const viewWorld = v.map((row) => [0, 1, 2].map((c) => row[0] * w[0][c] + row[1] * w[1][c] + row[2] * w[2][c]) as Row);
  const full = viewWorld.map((row) =>
    [0, 1, 2].map((c) => (row[0] * rotation[0][c] + row[1] * rotation[1][c] + row[2] * rotation[2][c]) * Math.exp(gaussian.logScale[c])) as Row,
  );
  const m0 = [0, 1, 2].map((c) => (view.fx / z) * (full[0][c] - tx * full[2][c])) as Row;
  const m1 = [0, 1, 2].map((c) => (view.fy / z) * (full[1][c] - ty * full[2][c])) as Row;
  const a = dot3(m0, m0);
  const b = dot3(m0, m1);
  const c = dot3(m1, m1);
  const minor: Row = [m0[1] * m1[2] - m0[2] * m1[1], m0[2] * m1[0] - m0[0] * m1[2], m0[0] * m1[1] - m0[1] * m1[0]];
  const sharp = dot3(minor, minor);
  const blurred = sharp + 0.3 * (a + c) + 0.09;
  const alpha = mip ? gaussian.opacity * Math.sqrt(sharp / blurred) : gaussian.opacity;
  if (!(alpha >= 1 / 255)) return null;
  const radius = Math.sqrt(2 * Math.log(255 * alpha));
  return {
    x: view.fx * (camera[0] / z) + view.cx,
    y: view.fy * (camera[1] / z) + view.cy,
    z,
    inverse: [(c + 0.3) / blurred, -b / blurred, (a + 0.3) / blurred],
    reach: [radius * Math.sqrt(a + 0.3) + 1, radius * Math.sqrt(c + 0.3) + 1],
    alpha,
    color: gaussian.color,
  };
}

/** Visible Gaussians, far to near. */
export function referenceOrder(scene: SyntheticScene, view: View, mip = true): Uint32Array {
  const depths = scene.gaussians.map((gaussian, index) => ({ index, splat: project(gaussian, scene.transforms, view, mip) }));
  const seen = depths.filter((entry) => entry.splat !== null);
  seen.sort((p, q) => q.splat!.z - p.splat!.z);
  return new Uint32Array(seen.map((entry) => entry.index));
}

export const srgb = (linear: number): number => (linear <= 0.0031308 ? 12.92 * linear : 1.055 * linear ** (1 / 2.4) - 0.055);
export const linearOf = (value: number): number => (value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4);

/** Of one Gaussian at one place of the picture; 0: nothing. */
function alphaAt({ x, y, inverse: [a, b, c], alpha }: Splat, px: number, py: number): number {
  const [dx, dy] = [px - x, py - y];
  const there = Math.min(0.999, alpha * Math.exp(-0.5 * (a * dx * dx + 2 * b * dx * dy + c * dy * dy)));
  return there < 1 / 255 ? 0 : there;
}

/** [height][width][3] in [0, 255], not rounded, row 0 on top. */
export function referencePicture(scene: SyntheticScene, view: View, background: readonly [number, number, number], mip = true): Float64Array {
  const { width, height } = view;
  const linear = new Float64Array(3 * width * height);
  const transmittance = new Float64Array(width * height).fill(1);
  const order = referenceOrder(scene, view, mip);
  for (let k = order.length - 1; k >= 0; --k) {
    const splat = project(scene.gaussians[order[k]], scene.transforms, view, mip)!;
    const first = (centre: number, reach: number): number => Math.max(0, Math.floor(centre - reach));
    const last = (centre: number, reach: number, size: number): number => Math.min(size - 1, Math.ceil(centre + reach));
    for (let y = first(splat.y, splat.reach[1]); y <= last(splat.y, splat.reach[1], height); ++y) {
      for (let x = first(splat.x, splat.reach[0]); x <= last(splat.x, splat.reach[0], width); ++x) {
        const alpha = alphaAt(splat, x + 0.5, y + 0.5);
        if (alpha === 0) continue;
        const at = y * width + x;
        const weight = alpha * transmittance[at];
        for (let channel = 0; channel < 3; ++channel) linear[3 * at + channel] += weight * splat.color[channel];
        transmittance[at] -= weight;
      }
    }
  }
  return linear.map((value, i) => {
    const whole = value + transmittance[Math.floor(i / 3)] * background[i % 3];
    return 255 * srgb(Math.min(Math.max(whole, 0), 1));
  });
}

/** How many standard deviations a Gaussian's mean is from a point of the world. */
function deviations({ mean, rotation, logScale, object }: Gaussian, transforms: Float32Array, point: Row): number {
  const w: Row[] = [0, 1, 2].map((r) => [...transforms.subarray(12 * object + 4 * r, 12 * object + 4 * r + 3)] as Row);
  const off = point.map((value, r) => value - transforms[12 * object + 4 * r + 3]) as Row;
  // The transforms here are turns and one factor.
  const factor = dot3(w[0], w[0]);
  const local = [0, 1, 2].map((c) => (w[0][c] * off[0] + w[1][c] * off[1] + w[2][c] * off[2]) / factor - mean[c]) as Row;
  const turned = rotationMatrix(rotation);
  return Math.hypot(...[0, 1, 2].map((c) => (turned[0][c] * local[0] + turned[1][c] * local[1] + turned[2][c] * local[2]) / Math.exp(logScale[c])));
}

/**
 * The Gaussian with which that place of a picture, nearest first, comes to hide half of what is behind it, and where on the way
 * there from the eye it is densest, in the world: found by trying. Null: it never does.
 */
export function referenceSurface(scene: SyntheticScene, view: View, x: number, y: number, mip = true): { row: number; point: Row } | null {
  const v = view.viewFromWorld;
  const tangents = [(x - view.cx) / view.fx, (y - view.cy) / view.fy, 1];
  const at = (depth: number): Row =>
    [0, 1, 2].map((k) => [0, 1, 2].reduce((sum, r) => sum + v[4 * r + k] * (tangents[r] * depth - v[4 * r + 3]), 0)) as Row;
  let through = 1;
  for (const row of [...referenceOrder(scene, view, mip)].reverse()) {
    through *= 1 - alphaAt(project(scene.gaussians[row], scene.transforms, view, mip)!, x, y);
    if (through > 0.5) continue;
    const far = (depth: number): number => deviations(scene.gaussians[row], scene.transforms, at(depth));
    let [low, high] = [0, 1000];
    for (let k = 0; k < 200; ++k) {
      const third = (high - low) / 3;
      if (far(low + third) < far(high - third)) high -= third;
      else low += third;
    }
    return { row, point: at(low) };
  }
  return null;
}
