import { cameraFromObjects, kTransformFloats, scaledView } from '../../math';
import type { ColorUpdate, RowUpdate } from '../../records';
import { inTime } from '../in_time';
import { blendedBackground, fitTo, GraphicsError, tangentLimits, targetSize, type Frame, type Picture, type Renderer, type Uploaded } from '../renderer';
import { texts } from '../../texts';
import { DepthOrder, DepthPipelines } from './depth_order';
import { bindGroup, RowBuffers } from './row_buffers';
import { kResolve, kSplats } from './triangle_shaders';

const kViewBytes = 80;
const kErrors = ['validation', 'out-of-memory', 'internal'] as const;

export class WebGpuRenderer implements Renderer {
  readonly api = 'webgpu';
  readonly sortsItself = true;
  readonly lost: Promise<string>;
  /** The device is there, and cannot draw: out of memory, or not able to do what is asked. Then `lost` resolves as well. */
  readonly failed: Promise<string>;
  isLost = false;
  readonly #rows: RowBuffers;
  readonly #pipelines: DepthPipelines;
  readonly #view: GPUBuffer;
  readonly #splats: GPURenderPipeline;
  readonly #resolves = new Map<GPUTextureFormat, GPURenderPipeline>();
  readonly #resolveModule: GPUShaderModule;
  readonly #between: GPUSampler;
  #objects: GPUBuffer;
  #order: DepthOrder | null = null;
  #orderOf: GPUBuffer | null = null;
  #splatGroup: GPUBindGroup | null = null;
  #target: GPUTexture | null = null;

  /** Throws GraphicsError where the browser has no WebGPU, or does not answer. */
  static async make(canvas: HTMLCanvasElement): Promise<WebGpuRenderer> {
    if (!navigator.gpu) throw new GraphicsError(texts.lacks.webgpu);
    const adapter = await inTime(navigator.gpu.requestAdapter({ powerPreference: 'high-performance' }));
    if (!adapter) throw new GraphicsError(texts.lacks.device);
    const { maxStorageBufferBindingSize, maxBufferSize } = adapter.limits;
    const device = await inTime(adapter.requestDevice({ requiredLimits: { maxStorageBufferBindingSize, maxBufferSize } }), (late) => late.destroy());
    const context = canvas.getContext('webgpu');
    if (!context) throw new GraphicsError(texts.lacks.canvas);
    return new WebGpuRenderer(canvas, device, context);
  }

  private constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly device: GPUDevice,
    private readonly context: GPUCanvasContext,
  ) {
    let fail: (reason: string) => void = () => {};
    this.failed = new Promise((resolve) => (fail = resolve));
    // Nothing here makes errors by intent, and what WebGPU refuses it leaves out: the picture would be black, or stand.
    device.onuncapturederror = ({ error }) => fail(error.message);
    const gone = device.lost.then(({ message }) => `the WebGPU device was lost: ${message}`);
    this.lost = Promise.race([gone, this.failed]).then((reason) => {
      this.isLost = true;
      return reason;
    });
    context.configure({ device, format: navigator.gpu.getPreferredCanvasFormat(), alphaMode: 'opaque' });
    this.#rows = new RowBuffers(device, fail);
    this.#pipelines = new DepthPipelines(device);
    this.#view = device.createBuffer({ size: kViewBytes, usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST });
    this.#objects = this.#makeObjects(64);
    this.#splats = this.#makeSplats();
    this.#resolveModule = device.createShaderModule({ label: 'resolve', code: kResolve });
    this.#between = device.createSampler({ magFilter: 'linear', minFilter: 'linear' });
  }

  get uploaded(): Uploaded {
    return { ...this.#rows.uploaded, orderBytes: 0 };
  }

  apply(update: RowUpdate): void {
    this.#rows.apply(update);
  }

  recolor(update: ColorUpdate): void {
    this.#rows.recolor(update);
  }

  keepColors(): void {
    this.#rows.keepColors();
  }

  clear(): void {
    this.#rows.clear();
  }

  setOrder(): void {
    // Sorted here in every frame.
  }

  draw(frame: Frame): void {
    fitTo(frame.view, this.canvas);
    const commands = this.device.createCommandEncoder();
    this.#encode(commands, frame, this.context.getCurrentTexture());
    this.device.queue.submit([commands.finish()]);
  }

  async capture(frame: Frame): Promise<Picture> {
    const { width, height } = frame.view;
    // A picture that cannot be had is no reason to end the one that is shown.
    for (const kind of kErrors) this.device.pushErrorScope(kind);
    const texture = this.device.createTexture({
      size: [width, height],
      format: 'rgba8unorm',
      usage: GPUTextureUsage.RENDER_ATTACHMENT | GPUTextureUsage.COPY_SRC,
    });
    const bytesPerRow = 256 * Math.ceil((4 * width) / 256);
    const buffer = this.device.createBuffer({ size: bytesPerRow * height, usage: GPUBufferUsage.COPY_DST | GPUBufferUsage.MAP_READ });
    const commands = this.device.createCommandEncoder();
    this.#encode(commands, frame, texture);
    commands.copyTextureToBuffer({ texture }, { buffer, bytesPerRow }, [width, height]);
    this.device.queue.submit([commands.finish()]);
    const errors = await Promise.all(kErrors.map(() => this.device.popErrorScope()));
    const rgba = new Uint8ClampedArray(4 * width * height);
    try {
      const error = errors.find((one) => one !== null);
      if (error) throw new GraphicsError(error.message);
      await buffer.mapAsync(GPUMapMode.READ);
      const mapped = new Uint8Array(buffer.getMappedRange());
      for (let y = 0; y < height; ++y) rgba.set(mapped.subarray(y * bytesPerRow, y * bytesPerRow + 4 * width), 4 * width * y);
    } catch (error) {
      this.#dropTarget(); // who made it may have failed unheard
      throw error;
    } finally {
      buffer.destroy();
      texture.destroy();
    }
    return { width, height, rgba };
  }

  async finish(): Promise<void> {
    await this.device.queue.onSubmittedWorkDone();
  }

  dispose(): void {
    this.device.destroy();
  }

  #encode(commands: GPUCommandEncoder, frame: Frame, to: GPUTexture): void {
    const target = this.#targetOf(frame);
    this.#upload(frame, target);
    const order = this.#orderOfRows();
    order.encode(commands, this.#rows.used);
    const splats = commands.beginRenderPass({
      colorAttachments: [{ view: target.createView(), loadOp: 'clear', storeOp: 'store', clearValue: [0, 0, 0, 0] }],
    });
    splats.setPipeline(this.#splats);
    splats.setBindGroup(0, this.#splatGroup);
    splats.drawIndirect(order.drawArgs, 0);
    splats.end();
    const resolve = commands.beginRenderPass({
      colorAttachments: [{ view: to.createView(), loadOp: 'clear', storeOp: 'store' }],
    });
    const pipeline = this.#resolveTo(to.format);
    resolve.setPipeline(pipeline);
    resolve.setBindGroup(0, bindGroup(this.device, pipeline, { 0: this.#view, 1: target.createView(), 2: this.#between }));
    resolve.draw(3);
    resolve.end();
  }

  #upload(frame: Frame, target: GPUTexture): void {
    const { scene } = frame;
    const view = scaledView(frame.view, target.width, target.height);
    const bytes = new ArrayBuffer(kViewBytes);
    const floats = new Float32Array(bytes);
    const words = new Uint32Array(bytes);
    floats.set([view.fx, view.fy, view.cx, view.cy, ...tangentLimits(view), view.width, view.height, frame.timeS], 0);
    words[11] = this.#rows.used;
    floats.set(blendedBackground(scene), 12);
    words[15] = Number(scene.displaySpace);
    words[16] = this.#rows.harmonicWords;
    floats[17] = frame.colorPart;
    words[18] = Number(frame.mip);
    this.device.queue.writeBuffer(this.#view, 0, bytes);
    const objects = new Float32Array(scene.transforms.length);
    cameraFromObjects(frame.view, scene.transforms, scene.farField, objects);
    if (objects.byteLength > this.#objects.size) {
      this.#objects.destroy();
      this.#objects = this.#makeObjects((2 * objects.length) / kTransformFloats);
      this.#orderOf = null;
    }
    this.device.queue.writeBuffer(this.#objects, 0, objects);
  }

  /** Made anew where the rows, or the objects, lie elsewhere than before. */
  #orderOfRows(): DepthOrder {
    if (this.#order && this.#orderOf === this.#rows.harmonics) return this.#order;
    this.#order?.destroy();
    this.#order = new DepthOrder(this.device, this.#pipelines, this.#view, this.#rows, this.#objects);
    this.#orderOf = this.#rows.harmonics; // they move whenever the records do
    const { order, splats } = this.#order;
    this.#splatGroup = bindGroup(this.device, this.#splats, { 0: this.#view, 1: order, 2: splats });
    return this.#order;
  }

  #makeObjects(count: number): GPUBuffer {
    const size = 4 * kTransformFloats * count;
    return this.device.createBuffer({ size, usage: GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_DST });
  }

  #makeSplats(): GPURenderPipeline {
    const module = this.device.createShaderModule({ label: 'splats', code: kSplats });
    const over: GPUBlendComponent = { srcFactor: 'one', dstFactor: 'one-minus-src-alpha', operation: 'add' };
    return this.device.createRenderPipeline({
      label: 'splats',
      layout: 'auto',
      vertex: { module },
      fragment: { module, targets: [{ format: 'rgba16float', blend: { color: over, alpha: over } }] },
    });
  }

  #resolveTo(format: GPUTextureFormat): GPURenderPipeline {
    let pipeline = this.#resolves.get(format);
    if (!pipeline) {
      const module = this.#resolveModule;
      pipeline = this.device.createRenderPipeline({ label: 'resolve', layout: 'auto', vertex: { module }, fragment: { module, targets: [{ format }] } });
      this.#resolves.set(format, pipeline);
    }
    return pipeline;
  }

  #targetOf(frame: Frame): GPUTexture {
    const { width, height } = targetSize(frame);
    if (this.#target?.width === width && this.#target.height === height) return this.#target;
    this.#dropTarget();
    this.#target = this.device.createTexture({
      size: [width, height],
      format: 'rgba16float',
      usage: GPUTextureUsage.RENDER_ATTACHMENT | GPUTextureUsage.TEXTURE_BINDING,
    });
    return this.#target;
  }

  #dropTarget(): void {
    this.#target?.destroy();
    this.#target = null;
  }
}
