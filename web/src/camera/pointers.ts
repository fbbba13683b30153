import { focalOf, type Rig } from './rig';
import { Taps } from './taps';

export const kRadiansAPixel = 0.006;

interface At {
  x: number;
  y: number;
}

const tapOf = ({ clientX, clientY, timeStamp }: PointerEvent): { x: number; y: number; ms: number } => ({ x: clientX, y: clientY, ms: timeStamp });

/** Where two fingers are: the middle between them, and how far apart they are. */
interface Pinch extends At {
  readonly apart: number;
}

/** Mouse, pen and fingers on the picture: one orbits, two pan and pinch; the other mouse buttons, or Shift, pan. Two taps pick. */
export class Pointers {
  readonly #down = new Map<number, At>();
  readonly #taps = new Taps();
  #panning = false;
  /** As the camera has followed it. */
  #pinch: Pinch | null = null;
  touched = false;
  /** Where two taps were, in focal lengths off the middle: to the right, and down. */
  onPick: (right: number, down: number) => void = () => {};

  constructor(
    private readonly element: HTMLElement,
    private readonly rig: Rig,
  ) {
    element.addEventListener('pointerdown', (event) => this.#press(event));
    element.addEventListener('pointermove', (event) => this.#move(event));
    for (const end of ['pointerup', 'pointercancel', 'lostpointercapture'] as const) {
      element.addEventListener(end, (event) => this.#release(event));
    }
    element.addEventListener('contextmenu', (event) => event.preventDefault());
  }

  /** To be called with every frame: each of two fingers has an event of its own, and one alone is no pinch yet. */
  advance(): void {
    const before = this.#pinch;
    const after = this.#pinchNow();
    if (before && after) {
      this.rig.pan(after.x - before.x, after.y - before.y, this.#focal);
      this.rig.zoom(before.apart / after.apart);
    }
    this.#pinch = after;
  }

  get #focal(): number {
    return focalOf(this.element.clientWidth, this.element.clientHeight);
  }

  #pinchNow(): Pinch | null {
    const [one, other, ...more] = this.#down.values();
    if (!one || !other || more.length > 0) return null;
    const apart = Math.max(Math.hypot(one.x - other.x, one.y - other.y), 1);
    return { x: (one.x + other.x) / 2, y: (one.y + other.y) / 2, apart };
  }

  #release(event: PointerEvent): void {
    this.advance();
    this.#down.delete(event.pointerId);
    this.#pinch = this.#pinchNow();
    if (event.type === 'pointercancel') this.#taps.cancel();
    if (event.type === 'pointerup' && this.#taps.release(tapOf(event))) this.#pick(event);
  }

  #pick(event: PointerEvent): void {
    const box = this.element.getBoundingClientRect();
    const right = event.clientX - (box.left + box.right) / 2;
    const down = event.clientY - (box.top + box.bottom) / 2;
    this.onPick(right / this.#focal, down / this.#focal);
  }

  #press(event: PointerEvent): void {
    this.element.focus({ preventScroll: true });
    this.element.setPointerCapture(event.pointerId);
    this.advance();
    this.#down.set(event.pointerId, { x: event.clientX, y: event.clientY });
    this.#pinch = this.#pinchNow();
    this.#panning = event.pointerType === 'mouse' && (event.button !== 0 || event.shiftKey);
    if (this.#panning || this.#down.size > 1) this.#taps.cancel();
    else this.#taps.press(tapOf(event));
    if (event.pointerType === 'touch' && !this.touched) {
      this.touched = true;
      this.element.dispatchEvent(new Event('touched', { bubbles: true }));
    }
    event.preventDefault();
  }

  #move(event: PointerEvent): void {
    const at = this.#down.get(event.pointerId);
    if (!at) return;
    const dx = event.clientX - at.x;
    const dy = event.clientY - at.y;
    at.x = event.clientX;
    at.y = event.clientY;
    if (this.#down.size !== 1) return; // two are followed with the frames
    if (this.#panning) this.rig.pan(dx, dy, this.#focal);
    else this.rig.orbit(dx * kRadiansAPixel, dy * kRadiansAPixel);
  }
}
