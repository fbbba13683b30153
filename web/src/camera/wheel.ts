import { clamp } from '../math';
import { kRadiansAPixel } from './pointers';
import { focalOf, type Rig } from './rig';

const kZoomANotch = 0.9;
const kPixelsANotch = 100;
const kPixelsALine = 33;
const kPixelsAPage = 400;
/** Browsers tell of a pinch on a trackpad as of a wheel with Ctrl: so many times the logarithm of how far fingers went apart. */
const kPinch = 100;
/** Of one event: a notch of a wheel looks like a pinch where Ctrl went down before the page had the focus. */
const kMostOfAPinch = 0.25;

/** Safari has an event of its own for that. */
interface GestureEvent extends Event {
  readonly scale: number;
}

/** Wheel and trackpad: up and down zoom, sideways orbits, with Shift both pan; a pinch zooms as far as it goes. */
export class Wheel {
  /** Somebody holds that key: it is a wheel's notch and no pinch. */
  #control = false;
  #scale = 1;

  constructor(
    private readonly element: HTMLElement,
    private readonly rig: Rig,
  ) {
    const held = (is: boolean) => (event: KeyboardEvent): void => {
      if (event.key === 'Control') this.#control = is;
    };
    addEventListener('keydown', held(true));
    addEventListener('keyup', held(false));
    addEventListener('blur', () => (this.#control = false));
    element.addEventListener('wheel', (event) => this.#turn(event), { passive: false });
    if (navigator.maxTouchPoints > 0) return; // it tells so of fingers on a screen, too, which are pointers already
    element.addEventListener('gesturestart', (event) => {
      event.preventDefault();
      this.#scale = 1;
    });
    element.addEventListener('gesturechange', (event) => this.#pinch(event as GestureEvent));
  }

  #turn(event: WheelEvent): void {
    event.preventDefault();
    const unit = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? kPixelsALine : event.deltaMode === WheelEvent.DOM_DELTA_PAGE ? kPixelsAPage : 1;
    const [x, y] = [event.deltaX * unit, event.deltaY * unit];
    const { clientWidth, clientHeight } = this.element;
    if (event.ctrlKey && !this.#control) this.rig.zoom(Math.exp(clamp(y / kPinch, -kMostOfAPinch, kMostOfAPinch)));
    else if (event.shiftKey) this.rig.pan(-x, -y, focalOf(clientWidth, clientHeight));
    else if (Math.abs(x) > Math.abs(y)) this.rig.orbit(-x * kRadiansAPixel, 0); // two fingers never go quite straight
    else this.rig.zoom(kZoomANotch ** (-y / kPixelsANotch));
  }

  #pinch(event: GestureEvent): void {
    event.preventDefault();
    if (!(event.scale > 0)) return;
    this.rig.zoom(this.#scale / event.scale);
    this.#scale = event.scale;
  }
}
