// Mean LDR-FLIP (Andersson et al., "FLIP: A Difference Evaluator for Alternating Images", HPG 2020) as libs/metrics has it;
// section numbers are the paper's.
import { filtered, plane, type Plane } from './planes';

/** A 0.7 m wide 4K monitor seen from 0.7 m. */
const kPixelsPerDegree = 67;
const kColorExponent = 0.7;
const kErrorCut = 0.4;
const kErrorAtCut = 0.95;
const kFeatureWidthDegrees = 0.082;

type Triple = [number, number, number];
type Planes = [Plane, Plane, Plane];

/** XYZ from linear sRGB, D65, each relative to the white of RGB (1, 1, 1). */
const kXyzFromRgb = ((): number[] => {
  const xyz = [
    10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794,
    2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897,
    1425312 / 73733382, 8788810 / 73733382, 70074185 / 73733382,
  ];
  return xyz.map((value, i) => value / (xyz[i - (i % 3)] + xyz[i - (i % 3) + 1] + xyz[i - (i % 3) + 2]));
})();

const kRgbFromXyz = ((): number[] => {
  const m = kXyzFromRgb;
  const minor = (r: number, c: number): number => {
    const [r1, r2, c1, c2] = [(r + 1) % 3, (r + 2) % 3, (c + 1) % 3, (c + 2) % 3];
    return m[3 * r1 + c1] * m[3 * r2 + c2] - m[3 * r1 + c2] * m[3 * r2 + c1];
  };
  const determinant = m[0] * minor(0, 0) + m[1] * minor(0, 1) + m[2] * minor(0, 2);
  return m.map((_, i) => minor(i % 3, Math.floor(i / 3)) / determinant);
})();

const times = (m: readonly number[], [x, y, z]: Triple): Triple => [
  m[0] * x + m[1] * y + m[2] * z,
  m[3] * x + m[4] * y + m[5] * z,
  m[6] * x + m[7] * y + m[8] * z,
];

/** YCxCz of section 4.1.1 and L*a*b* are the same combination, of relative XYZ and of its compressed form. */
const opponent = ([x, y, z]: Triple): Triple => [116 * y - 16, 500 * (x - y), 200 * (y - z)];

const kDelta = 6 / 29;
const compressed = (t: number): number => (t > kDelta ** 3 ? Math.cbrt(t) : t / (3 * kDelta * kDelta) + 4 / 29);

/** L*a*b*, a* and b* adjusted for the Hunt effect (section 4.1.2). */
function huntLab([x, y, z]: Triple): Triple {
  const [l, a, b] = opponent([compressed(x), compressed(y), compressed(z)]);
  return [l, 0.01 * l * a, 0.01 * l * b];
}

const hyab = (a: Triple, b: Triple): number => Math.abs(a[0] - b[0]) + Math.hypot(a[1] - b[1], a[2] - b[2]);

const kLinear = Float64Array.from({ length: 256 }, (_, i) => (i / 255 <= 0.04045 ? i / 255 / 12.92 : ((i / 255 + 0.055) / 1.055) ** 2.4));

function opponentPlanes(rgba: Uint8ClampedArray, width: number, height: number): Planes {
  const planes: Planes = [plane(width, height), plane(width, height), plane(width, height)];
  for (let i = 0; i < width * height; ++i) {
    const channels = opponent(times(kXyzFromRgb, [kLinear[rgba[4 * i]], kLinear[rgba[4 * i + 1]], kLinear[rgba[4 * i + 2]]]));
    planes.forEach(({ values }, c) => (values[i] = channels[c]));
  }
  return planes;
}

/** Contrast sensitivity of the opponent channels: sums of a sqrt(pi / b) exp(-pi^2 d^2 / b), d in degrees. */
const kSensitivities: readonly (readonly (readonly [a: number, b: number])[])[] = [
  [[1, 0.0047]],
  [[1, 0.0053]],
  [[34.1, 0.04], [13.5, 0.025]],
];
const kWidestScale = 0.04;

/** One-dimensional kernels whose outer squares add up to the channel's filter, of sum 1. */
function sensitivityKernels(terms: (typeof kSensitivities)[number]): number[][] {
  const radius = Math.ceil(3 * Math.sqrt(kWidestScale / (2 * Math.PI ** 2)) * kPixelsPerDegree);
  const kernels = terms.map(([a, b]) =>
    Array.from({ length: 2 * radius + 1 }, (_, i) => {
      const degrees = (i - radius) / kPixelsPerDegree;
      return Math.sqrt(a * Math.sqrt(Math.PI / b)) * Math.exp((-(Math.PI ** 2) * degrees ** 2) / b);
    }),
  );
  const sum = kernels.reduce((total, kernel) => total + kernel.reduce((x, y) => x + y, 0) ** 2, 0);
  return kernels.map((kernel) => kernel.map((tap) => tap / Math.sqrt(sum)));
}

const kKernels = kSensitivities.map(sensitivityKernels);

/** What is left of a picture at that distance, as Hunt-adjusted L*a*b*: [height][width][3]. */
function perceived(planes: Planes): Float32Array {
  const blurred = planes.map((channel, c) =>
    kKernels[c].map((kernel) => filtered(channel, kernel, kernel).values).reduce((a, b) => a.map((value, i) => value + b[i])),
  );
  const out = new Float32Array(3 * blurred[0].length);
  for (let i = 0; i < blurred[0].length; ++i) {
    const y = (blurred[0][i] + 16) / 116;
    const rgb = times(kRgbFromXyz, [y + blurred[1][i] / 500, y, y - blurred[2][i] / 200]);
    const bounded = rgb.map((value) => Math.min(Math.max(value, 0), 1)) as Triple;
    out.set(huntLab(times(kXyzFromRgb, bounded)), 3 * i);
  }
  return out;
}

const kLargest = hyab(huntLab(times(kXyzFromRgb, [0, 1, 0])), huntLab(times(kXyzFromRgb, [0, 0, 1]))) ** kColorExponent;

/** Section 4.1.3: the color difference, redistributed over [0, 1]. */
function colorDifference(a: Float32Array, b: Float32Array, i: number): number {
  const at = (lab: Float32Array): Triple => [lab[3 * i], lab[3 * i + 1], lab[3 * i + 2]];
  const error = hyab(at(a), at(b)) ** kColorExponent;
  const cut = kErrorCut * kLargest;
  return error < cut ? (error * kErrorAtCut) / cut : kErrorAtCut + ((error - cut) / (kLargest - cut)) * (1 - kErrorAtCut);
}

/** Section 4.2.1: a Gaussian and its first and second derivative; positive weights of a derivative sum to 1, negative to -1. */
const kFeatureKernels = ((): { smooth: number[]; edge: number[]; point: number[] } => {
  const sigma = 0.5 * kFeatureWidthDegrees * kPixelsPerDegree;
  const radius = Math.ceil(3 * sigma);
  const places = Array.from({ length: 2 * radius + 1 }, (_, i) => i - radius);
  const gauss = (x: number): number => Math.exp((-x * x) / (2 * sigma * sigma));
  const total = (kernel: readonly number[]): number => kernel.reduce((a, b) => a + b, 0);
  const balanced = (kernel: readonly number[]): number[] => {
    const positive = total(kernel.map((tap) => Math.max(tap, 0)));
    const negative = total(kernel.map((tap) => Math.max(-tap, 0)));
    return kernel.map((tap) => (tap > 0 ? tap / positive : tap / negative));
  };
  const smooth = places.map(gauss);
  return {
    smooth: smooth.map((tap) => tap / total(smooth)),
    edge: balanced(places.map((x) => -x * gauss(x))),
    point: balanced(places.map((x) => ((x * x) / (sigma * sigma) - 1) * gauss(x))),
  };
})();

/** Strength of edges and of points at every pixel of the achromatic channel. */
function features(achromatic: Plane): [Float32Array, Float32Array] {
  const y: Plane = { ...achromatic, values: achromatic.values.map((value) => (value + 16) / 116) };
  const { smooth, edge, point } = kFeatureKernels;
  const strength = (derivative: readonly number[]): Float32Array => {
    const across = filtered(y, derivative, smooth).values;
    const down = filtered(y, smooth, derivative).values;
    return across.map((value, i) => Math.hypot(value, down[i]));
  };
  return [strength(edge), strength(point)];
}

/** Of two RGBA pictures of one size; 0 is best. */
export function flip(a: Uint8ClampedArray, b: Uint8ClampedArray, width: number, height: number): number {
  const [planesA, planesB] = [opponentPlanes(a, width, height), opponentPlanes(b, width, height)];
  const [labA, labB] = [perceived(planesA), perceived(planesB)];
  const [edgeA, pointA] = features(planesA[0]);
  const [edgeB, pointB] = features(planesB[0]);
  let sum = 0;
  for (let i = 0; i < width * height; ++i) {
    // Section 4.2.2.
    const feature = Math.sqrt(Math.max(Math.abs(edgeA[i] - edgeB[i]), Math.abs(pointA[i] - pointB[i])) / Math.SQRT2);
    sum += colorDifference(labA, labB, i) ** (1 - feature);
  }
  return sum / (width * height);
}
