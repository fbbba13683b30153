import { focalOf, type Rig } from './rig';

const kRadiansAPixel = 0.006;
const kZoomANotch = 0.9;
const kPixelsANotch = 100;

interface At {
  x: number;
  y: number;
}

/** Mouse, pen and fingers on the picture: one orbits, two pan and pinch; the other mouse buttons, or Shift, pan. */
export class Pointers {
  readonly #down = new Map<number, At>();
  #panning = false;
  touched = false;

  constructor(
    private readonly element: HTMLElement,
    private readonly rig: Rig,
  ) {
    element.addEventListener('pointerdown', (event) => this.#press(event));
    element.addEventListener('pointermove', (event) => this.#move(event));
    for (const end of ['pointerup', 'pointercancel', 'lostpointercapture'] as const) {
      element.addEventListener(end, (event) => this.#down.delete(event.pointerId));
    }
    element.addEventListener('contextmenu', (event) => event.preventDefault());
    element.addEventListener('wheel', (event) => this.#wheel(event), { passive: false });
  }

  #press(event: PointerEvent): void {
    this.element.focus({ preventScroll: true });
    this.element.setPointerCapture(event.pointerId);
    this.#down.set(event.pointerId, { x: event.clientX, y: event.clientY });
    this.#panning = event.pointerType === 'mouse' && (event.button !== 0 || event.shiftKey);
    if (event.pointerType === 'touch' && !this.touched) {
      this.touched = true;
      this.element.dispatchEvent(new Event('touched', { bubbles: true }));
    }
    event.preventDefault();
  }

  #move(event: PointerEvent): void {
    const at = this.#down.get(event.pointerId);
    if (!at) return;
    const before = [...this.#down.values()].map((other) => ({ ...other }));
    const dx = event.clientX - at.x;
    const dy = event.clientY - at.y;
    at.x = event.clientX;
    at.y = event.clientY;
    const focal = focalOf(this.element.clientWidth, this.element.clientHeight);
    if (this.#down.size === 1) {
      if (this.#panning) this.rig.pan(dx, dy, focal);
      else this.rig.orbit(dx * kRadiansAPixel, dy * kRadiansAPixel);
    } else if (this.#down.size === 2) {
      const after = [...this.#down.values()];
      const apart = (two: readonly At[]): number => Math.max(Math.hypot(two[0].x - two[1].x, two[0].y - two[1].y), 1);
      this.rig.pan(dx / 2, dy / 2, focal);
      this.rig.zoom(apart(before) / apart(after));
    }
  }

  #wheel(event: WheelEvent): void {
    event.preventDefault();
    const pixels = event.deltaY * (event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 33 : event.deltaMode === WheelEvent.DOM_DELTA_PAGE ? 400 : 1);
    this.rig.zoom(kZoomANotch ** (-pixels / kPixelsANotch));
  }
}
