import type { Picture } from '../../src/render/renderer';

/** RGB of a picture as numbers. */
export function rgbOf(picture: Picture): Float64Array {
  const rgb = new Float64Array(3 * picture.width * picture.height);
  for (let i = 0; i < picture.width * picture.height; ++i) {
    for (let c = 0; c < 3; ++c) rgb[3 * i + c] = picture.rgba[4 * i + c];
  }
  return rgb;
}

/** Decibels, of values up to 255. */
export function psnr(a: Float64Array, b: Float64Array): number {
  const sum = a.reduce((total, value, i) => total + (value - b[i]) ** 2, 0);
  return 10 * Math.log10((255 * 255 * a.length) / Math.max(sum, 1e-12));
}

/** Mean structural similarity (Wang et al. 2004): Gaussian window of 11 pixels, sigma 1.5, channel by channel. */
export function ssim(a: Float64Array, b: Float64Array, width: number, height: number): number {
  const taps = Array.from({ length: 11 }, (_, i) => Math.exp(-((i - 5) ** 2) / 4.5));
  const total = taps.reduce((x, y) => x + y, 0);
  const blur = (plane: Float64Array): Float64Array => {
    const pass = (from: Float64Array, step: number, along: (i: number) => number, size: number): Float64Array =>
      from.map((_, i) => {
        let sum = 0;
        taps.forEach((tap, k) => {
          const shift = Math.min(Math.max(along(i) + k - 5, 0), size - 1) - along(i);
          sum += (tap / total) * from[i + shift * step];
        });
        return sum;
      });
    return pass(pass(plane, 1, (i) => i % width, width), width, (i) => Math.floor(i / width), height);
  };
  let sum = 0;
  for (let c = 0; c < 3; ++c) {
    const plane = (from: Float64Array): Float64Array => from.filter((_, i) => i % 3 === c);
    const x = plane(a);
    const y = plane(b);
    const mx = blur(x);
    const my = blur(y);
    const xx = blur(x.map((v) => v * v));
    const yy = blur(y.map((v) => v * v));
    const xy = blur(x.map((v, i) => v * y[i]));
    const c1 = (0.01 * 255) ** 2;
    const c2 = (0.03 * 255) ** 2;
    for (let i = 0; i < x.length; ++i) {
      const covariance = xy[i] - mx[i] * my[i];
      const variances = xx[i] - mx[i] ** 2 + yy[i] - my[i] ** 2;
      sum += ((2 * mx[i] * my[i] + c1) * (2 * covariance + c2)) / ((mx[i] ** 2 + my[i] ** 2 + c1) * (variances + c2));
    }
  }
  return sum / a.length;
}
