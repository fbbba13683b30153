// Compares pictures away from the page, which goes on drawing meanwhile.
import type { WorkerScope } from '../stream/messages';
import { flip } from './flip';
import { ssim } from './ssim';

export interface Pair {
  readonly id: number;
  readonly width: number;
  readonly height: number;
  /** RGBA, sRGB. */
  readonly picture: Uint8ClampedArray<ArrayBuffer>;
  readonly reference: Uint8ClampedArray<ArrayBuffer>;
}
export interface PairQuality {
  readonly id: number;
  readonly ssim: number;
  readonly flip: number;
}

const scope = self as unknown as WorkerScope<Pair, PairQuality>;
scope.onmessage = ({ data: { id, width, height, picture, reference } }) =>
  scope.postMessage({ id, ssim: ssim(picture, reference, width, height), flip: flip(picture, reference, width, height) });
