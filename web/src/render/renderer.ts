import type { View } from '../math';
import type { ColorUpdate, RowUpdate, Scene } from '../records';

/** What one frame shows of the rows. */
export interface Frame {
  readonly view: View;
  readonly scene: Scene;
  /** Pixels of the splats' own target, for those of the view: below 1 it is drawn coarser and enlarged. */
  readonly resolution: number;
  /** The clock of RowUpdate.fades. */
  readonly timeS: number;
  /** How far colors are from those that keepColors() has kept to those that there are: at 1. */
  readonly colorPart: number;
  /** What is smaller than a pixel becomes as much fainter as it is made larger: the model was trained so (Mip-Splatting). */
  readonly mip: boolean;
}

/** What an eye sees, and where in the target, from its lower left corner. */
export interface Eye {
  readonly view: View;
  readonly x: number;
  readonly y: number;
}

/** Row 0 on top, sRGB, opaque. */
export interface Picture {
  readonly width: number;
  readonly height: number;
  readonly rgba: Uint8ClampedArray<ArrayBuffer>;
}

/** To the GPU, so far. */
export interface Uploaded {
  /** Of apply() and recolor(). */
  readonly rows: number;
  readonly bytes: number;
  /** Of setOrder(). */
  readonly orderBytes: number;
}

/** The browser or its device lacks something. */
export class GraphicsError extends Error {
  override readonly name = 'GraphicsError';
}

/** How long a row takes to appear and to vanish. */
export const kFadeS = 0.25;
/** As a row's fade: it has always been there. */
export const kNoFade = 0;

/**
 * Draws rows of Gaussians as the project's CPU rasteriser does: the local affine approximation, 0.3 pixels^2 of low pass
 * with the opacity that it takes away (Frame.mip), tangents clamped to 1.3 times the field of view, alpha at most 0.999 and nothing
 * below 1/255; linear light, back to front, into 16-bit floats; then background and the sRGB curve.
 */
export interface Renderer {
  readonly api: 'webgl2' | 'webgpu';
  /** False: setOrder() says which rows there are, back to front. */
  readonly sortsItself: boolean;
  readonly uploaded: Uploaded;
  /** Resolves, with a reason, when the device is gone: nothing is drawn any more, and another renderer is needed. */
  readonly lost: Promise<string>;
  /** The same at this moment, before anybody can hear of it: what a canvas has then is no picture. */
  readonly isLost: boolean;

  /** Its colors are those to keep as well. */
  apply(update: RowUpdate): void;
  recolor(update: ColorUpdate): void;
  /** The colors that there are become those from which Frame.colorPart goes; nothing is uploaded. */
  keepColors(): void;
  /** Every row is free again. */
  clear(): void;
  setOrder(order: Uint32Array): void;
  /** To the canvas, which has the view's size afterwards. */
  draw(frame: Frame): void;
  /** The same picture to memory; the canvas keeps what it shows. */
  capture(frame: Frame): Promise<Picture>;
  /** Resolves when all that was drawn has been. */
  finish(): Promise<void>;
  dispose(): void;
}

/** A renderer that WebXR can have draw. */
export interface EyeRenderer extends Renderer {
  /** Its context was made for a headset. */
  readonly forHeadset: boolean;
  /** Its context, on the device that the headset hangs on. */
  forXr(): Promise<WebGL2RenderingContext>;
  /** All eyes in the order that stands; `frame.view` is not looked at. */
  drawEyes(target: WebGLFramebuffer | null, eyes: readonly Eye[], frame: Frame): void;
}

const srgb = (linear: number): number => (linear <= 0.0031308 ? 12.92 * linear : 1.055 * linear ** (1 / 2.4) - 0.055);

/** The background in the space that colors are blended in. */
export function blendedBackground(scene: Scene): [number, number, number] {
  const [r, g, b] = scene.background;
  return scene.displaySpace ? [srgb(r), srgb(g), srgb(b)] : [r, g, b];
}

/** Gives the canvas the view's size; setting what it has already would clear it. */
export function fitTo({ width, height }: View, canvas: HTMLCanvasElement): void {
  if (canvas.width !== width) canvas.width = width;
  if (canvas.height !== height) canvas.height = height;
}

/** Size of the splats' own target. */
export function targetSize(frame: Frame): { width: number; height: number } {
  const side = (pixels: number): number => Math.max(1, Math.round(pixels * frame.resolution));
  return { width: side(frame.view.width), height: side(frame.view.height) };
}

/** 0.3 of the half field of view beyond the picture's sides: left, right, top, bottom, as tangents. */
export function tangentLimits(view: View): [number, number, number, number] {
  const x = (0.15 * view.width) / view.fx;
  const y = (0.15 * view.height) / view.fy;
  return [
    -view.cx / view.fx - x,
    (view.width - view.cx) / view.fx + x,
    -view.cy / view.fy - y,
    (view.height - view.cy) / view.fy + y,
  ];
}
