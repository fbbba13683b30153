import { texts } from '../texts';

/** A stick on the screen, for those who touch: where it is held, in [-1, 1] to the right and upwards. */
export class Stick {
  readonly element = document.createElement('div');
  readonly #knob = document.createElement('div');
  at: readonly [number, number] = [0, 0];

  constructor() {
    this.element.className = 'stick';
    this.element.hidden = true;
    this.element.setAttribute('role', 'img');
    this.element.setAttribute('aria-label', texts.stick);
    this.#knob.className = 'knob';
    this.element.append(this.#knob);
    const move = (event: PointerEvent): void => {
      const box = this.element.getBoundingClientRect();
      const x = (event.clientX - box.left) / (box.width / 2) - 1;
      const y = 1 - (event.clientY - box.top) / (box.height / 2);
      const far = Math.max(Math.hypot(x, y), 1);
      this.#set(x / far, y / far);
    };
    this.element.addEventListener('pointerdown', (event) => {
      this.element.setPointerCapture(event.pointerId);
      move(event);
      event.preventDefault();
    });
    this.element.addEventListener('pointermove', (event) => {
      if (this.element.hasPointerCapture(event.pointerId)) move(event);
    });
    for (const end of ['pointerup', 'pointercancel', 'lostpointercapture'] as const) {
      this.element.addEventListener(end, () => this.#set(0, 0));
    }
  }

  #set(x: number, y: number): void {
    this.at = [x, y];
    this.#knob.style.translate = `${x * 36}px ${-y * 36}px`;
  }
}
