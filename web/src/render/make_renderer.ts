import { inTime } from './in_time';
import type { Renderer } from './renderer';
import { WebGl2Renderer } from './webgl2/webgl2_renderer';
import { WebGpuRenderer } from './webgpu/webgpu_renderer';

export type Api = 'webgl2' | 'webgpu';

let webGpuFailed = false;

/** Whether a canvas can be drawn by a WebGPU device that is no software. */
async function hasFastWebGpu(): Promise<boolean> {
  if (webGpuFailed) return false;
  if (!navigator.gpu) return false;
  const adapter = await inTime(navigator.gpu.requestAdapter({ powerPreference: 'high-performance' })).catch(() => null);
  return adapter !== null && !adapter.info.isFallbackAdapter;
}

/**
 * By the interface that is asked for, or by the best that there is: WebGPU, but where only software would do it WebGL2.
 * Throws where the browser lacks it.
 */
export async function makeRenderer(canvas: HTMLCanvasElement, wanted: Api | null): Promise<Renderer> {
  if (wanted === 'webgpu') return WebGpuRenderer.make(canvas);
  if (wanted === null && (await hasFastWebGpu())) {
    try {
      return await WebGpuRenderer.make(canvas);
    } catch (error) {
      // A canvas that WebGPU has had gives no other context: then the next start, with a canvas of its own, draws.
      console.warn(error);
      webGpuFailed = true;
    }
  }
  return new WebGl2Renderer(canvas);
}
