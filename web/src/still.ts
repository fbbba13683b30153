import { make } from './ui/dom';

const kQuality = 0.95;
/** While things move reading a picture back is a hitch, which grows with it: then seldom, and of so many pixels at most along a side. */
const kMovingEveryMs = 10_000;
const kMovingPixels = 640;

/**
 * The last picture, beneath the canvas that draws: it is there at the moment when that one shows nothing any more. No canvas
 * itself, for all of a page's go with the GPU's process.
 */
export class Still {
  readonly element = make('img', { class: 'still', alt: '', decoding: 'sync', hidden: '' });
  #takenMs = -Infinity;

  /** `canvas` has just been drawn; what it gives is kept if it `counts` once it is there. */
  take(canvas: HTMLCanvasElement, atRest: boolean, counts: () => boolean): void {
    const now = performance.now();
    if (!atRest && now - this.#takenMs < kMovingEveryMs) return;
    this.#takenMs = now;
    const of = atRest ? canvas : smaller(canvas);
    of.toBlob((blob) => blob && counts() && this.#keep(blob), 'image/jpeg', kQuality);
  }

  #keep(picture: Blob): void {
    const before = this.element.src;
    this.element.src = URL.createObjectURL(picture);
    this.element.hidden = false;
    if (before) URL.revokeObjectURL(before);
  }
}

function smaller(canvas: HTMLCanvasElement): HTMLCanvasElement {
  const part = Math.min(1, kMovingPixels / Math.max(canvas.width, canvas.height));
  const copy = make('canvas');
  copy.width = Math.max(1, Math.round(part * canvas.width));
  copy.height = Math.max(1, Math.round(part * canvas.height));
  copy.getContext('2d')?.drawImage(canvas, 0, 0, copy.width, copy.height);
  return copy;
}
