/** One channel of a picture, row 0 on top. */
export interface Plane {
  readonly width: number;
  readonly height: number;
  readonly values: Float32Array;
}

export const plane = (width: number, height: number): Plane => ({ width, height, values: new Float32Array(width * height) });

/** Along rows by one kernel of odd length and along columns by another; beyond the borders is what is at them. */
export function filtered(from: Plane, kernelX: readonly number[], kernelY: readonly number[]): Plane {
  const { width, height } = from;
  const along = (values: Float32Array, kernel: readonly number[], isX: boolean): Float32Array => {
    const out = new Float32Array(values.length);
    const radius = (kernel.length - 1) / 2;
    const last = (isX ? width : height) - 1;
    const stride = isX ? 1 : width;
    for (let y = 0; y < height; ++y) {
      for (let x = 0; x < width; ++x) {
        const at = isX ? x : y;
        const start = y * width + x - at * stride;
        let sum = 0;
        for (let k = -radius; k <= radius; ++k) {
          const from = at + k < 0 ? 0 : at + k > last ? last : at + k;
          sum += kernel[k + radius] * values[start + from * stride];
        }
        out[y * width + x] = sum;
      }
    }
    return out;
  };
  return { width, height, values: along(along(from.values, kernelX, true), kernelY, false) };
}
