// Mean SSIM (Wang et al. 2004) as libs/metrics has it: each of R, G and B, a Gaussian window of 11 pixels, sigma 1.5, over the
// pixels whose window lies inside the picture.

const kWindow = 11;
const kRadius = 5;
const kC1 = (0.01 * 255) ** 2;
const kC2 = (0.03 * 255) ** 2;

const kTaps = ((): readonly number[] => {
  const taps = Array.from({ length: kWindow }, (_, i) => Math.exp(-((i - kRadius) ** 2) / (2 * 1.5 ** 2)));
  const sum = taps.reduce((a, b) => a + b, 0);
  return taps.map((tap) => tap / sum);
})();

/** [height - 10][width - 10] */
function windowMeans(values: Float64Array, width: number, height: number): Float64Array {
  const inner = width - 2 * kRadius;
  const rows = new Float64Array(inner * height);
  for (let y = 0; y < height; ++y) {
    for (let x = 0; x < inner; ++x) {
      let sum = 0;
      for (let k = 0; k < kWindow; ++k) sum += kTaps[k] * values[y * width + x + k];
      rows[y * inner + x] = sum;
    }
  }
  const out = new Float64Array(inner * (height - 2 * kRadius));
  for (let i = 0; i < out.length; ++i) {
    let sum = 0;
    for (let k = 0; k < kWindow; ++k) sum += kTaps[k] * rows[i + k * inner];
    out[i] = sum;
  }
  return out;
}

/** Of two RGBA pictures, with sides of at least 11 pixels. */
export function ssim(a: Uint8ClampedArray, b: Uint8ClampedArray, width: number, height: number): number {
  let sum = 0;
  let count = 0;
  const x = new Float64Array(width * height);
  const y = new Float64Array(width * height);
  const product = new Float64Array(width * height);
  const meansOf = (p: Float64Array, q: Float64Array): Float64Array => {
    for (let i = 0; i < p.length; ++i) product[i] = p[i] * q[i];
    return windowMeans(product, width, height);
  };
  for (let channel = 0; channel < 3; ++channel) {
    for (let i = 0; i < x.length; ++i) {
      x[i] = a[4 * i + channel];
      y[i] = b[4 * i + channel];
    }
    const [mx, my] = [windowMeans(x, width, height), windowMeans(y, width, height)];
    const [xx, yy, xy] = [meansOf(x, x), meansOf(y, y), meansOf(x, y)];
    for (let i = 0; i < mx.length; ++i) {
      const squares = mx[i] ** 2 + my[i] ** 2;
      const covariance = xy[i] - mx[i] * my[i];
      const variances = xx[i] + yy[i] - squares;
      sum += ((2 * mx[i] * my[i] + kC1) * (2 * covariance + kC2)) / ((squares + kC1) * (variances + kC2));
    }
    count += mx.length;
  }
  return sum / count;
}
