import { inTime } from './in_time';
import type { Renderer } from './renderer';
import { WebGl2Renderer } from './webgl2/webgl2_renderer';
import { WebGpuRenderer } from './webgpu/webgpu_renderer';

export type Api = 'webgl2' | 'webgpu';

let webGpuFailed = false;

/** From now on WebGL2 draws, whatever is asked for: WebGPU has shown that it cannot. */
export function giveUpWebGpu(): void {
  webGpuFailed = true;
}

/** Not every browser with WebGPU has what says so, and for a while it was elsewhere. */
const isSoftware = (adapter: GPUAdapter): boolean =>
  (adapter.info as GPUAdapterInfo | undefined)?.isFallbackAdapter ?? (adapter as { isFallbackAdapter?: boolean }).isFallbackAdapter ?? false;

/** Whether a canvas can be drawn by a WebGPU device that is no software. */
async function hasFastWebGpu(): Promise<boolean> {
  if (!navigator.gpu) return false;
  const adapter = await inTime(navigator.gpu.requestAdapter({ powerPreference: 'high-performance' }));
  return adapter !== null && !isSoftware(adapter);
}

async function makeWebGpu(canvas: HTMLCanvasElement): Promise<Renderer> {
  const renderer = await WebGpuRenderer.make(canvas);
  void renderer.failed.then(giveUpWebGpu);
  return renderer;
}

/**
 * By the interface that is asked for, or by the best that there is: WebGPU, but where only software would do it WebGL2.
 * Where there is no WebGPU it is WebGL2 all the same: an address is passed on to other browsers. Throws where the browser
 * lacks that too. `forHeadset`: by WebGL2, on the device that the headset hangs on.
 */
export async function makeRenderer(canvas: HTMLCanvasElement, wanted: Api | null, forHeadset = false): Promise<Renderer> {
  if (forHeadset || webGpuFailed) return new WebGl2Renderer(canvas, forHeadset);
  if (wanted !== 'webgl2') {
    try {
      if (wanted === 'webgpu' ? navigator.gpu : await hasFastWebGpu()) return await makeWebGpu(canvas);
    } catch (error) {
      // A canvas that WebGPU has had gives no other context: then the next start, with a canvas of its own, draws.
      console.warn(error);
      giveUpWebGpu();
    }
  }
  return new WebGl2Renderer(canvas);
}
