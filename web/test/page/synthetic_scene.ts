// Records of a scene that no engine made, and the same Gaussians in double precision for the reference. Packing is written
// here anew, from the layout's text, so that a mistake in the shaders' unpacking is seen.

export interface Gaussian {
  mean: [number, number, number];
  logScale: [number, number, number];
  rotation: [number, number, number];
  opacity: number;
  object: number;
  color: [number, number, number];
}

export interface SyntheticScene {
  gaussians: Gaussian[];
  records: Uint32Array;
  transforms: Float32Array;
}

/** Numbers in [0, 1) that are the same everywhere (mulberry32). */
export function randomNumbers(seed: number): () => number {
  let state = seed;
  return () => {
    state = (state + 0x6d2b79f5) | 0;
    let t = Math.imul(state ^ (state >>> 15), 1 | state);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
  };
}

function packColor(color: readonly number[]): { word: number; values: [number, number, number] } {
  const largest = Math.max(...color, 2 ** -24);
  const exponent = Math.max(-15, Math.floor(Math.log2(largest)) + 1);
  const step = 2 ** (exponent - 9);
  const mantissa = color.map((value) => Math.min(511, Math.round(value / step)));
  const word = (mantissa[0] | (mantissa[1] << 9) | (mantissa[2] << 18) | ((exponent + 15) << 27)) >>> 0;
  return { word, values: [mantissa[0] * step, mantissa[1] * step, mantissa[2] * step] };
}

/** Writes `gaussian` to 32 bytes, and rounds it to what these hold. */
export function packRecord(gaussian: Gaussian, bytes: DataView): void {
  const three = [0, 1, 2] as const;
  for (const k of three) {
    gaussian.mean[k] = Math.fround(gaussian.mean[k]);
    bytes.setFloat32(4 * k, gaussian.mean[k], true);
    const logScale = Math.round(gaussian.logScale[k] * 1024);
    bytes.setInt16(12 + 2 * k, logScale, true);
    gaussian.logScale[k] = logScale / 1024;
    const rotation = Math.round((gaussian.rotation[k] / Math.PI) * 32767);
    bytes.setInt16(18 + 2 * k, rotation, true);
    gaussian.rotation[k] = (rotation / 32767) * Math.PI;
  }
  const opacity = Math.round(gaussian.opacity * 255);
  bytes.setUint32(24, (gaussian.object * 256 + opacity) >>> 0, true);
  gaussian.opacity = opacity / 255;
  const color = packColor(gaussian.color);
  bytes.setUint32(28, color.word, true);
  gaussian.color = color.values;
}

export function packRecords(gaussians: readonly Gaussian[]): Uint32Array {
  const buffer = new ArrayBuffer(32 * gaussians.length);
  gaussians.forEach((gaussian, index) => packRecord(gaussian, new DataView(buffer, 32 * index, 32)));
  return new Uint32Array(buffer);
}

const kIdentity = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0];
/** A quarter turn about y, twice the size, two metres up. */
const kTurned = [0, 0, 2, 0.4, 0, 2, 0, 1.2, -2, 0, 0, -0.3];
const kHidden = new Array<number>(12).fill(0);

/** A wavy floor, needles, discs and a blob of another object; a few belong to an object that is hidden. */
export function syntheticScene(count: number, seed = 1): SyntheticScene {
  const random = randomNumbers(seed);
  const gaussians: Gaussian[] = [];
  for (let i = 0; i < count; ++i) {
    const kind = random();
    const x = 4 * random() - 2;
    const z = 4 * random() - 2;
    const object = kind < 0.8 ? 0 : kind < 0.95 ? 1 : 2;
    const spread = Math.sqrt(2000 / count);
    const size = (): number => Math.log(spread * 0.05) + 1.4 * (random() - 0.5);
    gaussians.push({
      mean: object === 0 ? [x, 0.2 * Math.sin(3 * x) * Math.cos(2 * z), z] : [0.4 * (random() - 0.5), 0.4 * (random() - 0.5), 0.4 * (random() - 0.5)],
      logScale: [size(), size() - 2 * random(), size() - 3 * random()],
      rotation: [2 * (random() - 0.5), 2 * (random() - 0.5), 2 * (random() - 0.5)],
      opacity: random() < 0.2 ? 1 : 0.02 + 0.98 * random(),
      object,
      color: [random() ** 2, random() ** 2, random() * (kind < 0.05 ? 6 : 1)],
    });
  }
  return { records: packRecords(gaussians), gaussians, transforms: new Float32Array([...kIdentity, ...kTurned, ...kHidden]) };
}
