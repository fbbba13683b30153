import type { StreamFigures } from './messages';

const kEveryMs = 250;

const isWhole = ({ gaussians, missing }: StreamFigures): boolean => gaussians > 0 && missing === 0;

/** When figures are to be said: now and then, and at once when the model has become whole or is another. */
export class FiguresDue {
  #said: StreamFigures | null = null;

  /** The next are due, whatever they are. */
  hurry(): void {
    this.#said = null;
  }

  /** Whether these are; they count as said then. */
  take(figures: StreamFigures): boolean {
    const said = this.#said;
    const isNews = !said || figures.epoch !== said.epoch || (isWhole(figures) && !isWhole(said));
    if (!isNews && figures.atMs - said.atMs < kEveryMs) return false;
    this.#said = figures;
    return true;
  }
}
