import { scaledView } from '../../math';
import type { ColorUpdate, RowUpdate } from '../../records';
import { texts } from '../../texts';
import { blendedBackground, fitTo, GraphicsError, targetSize, type Eye, type EyeRenderer, type Frame, type Picture, type Uploaded } from '../renderer';
import { Program, makeTarget, makeTexture, type Gl } from './gl';
import { Projection } from './projection';
import { RowStore } from './row_store';
import { kResolveFragment, kSplatFragment, kSplatVertex, kWholeVertex } from './shaders';

const kContext = { alpha: false, antialias: false, depth: false, powerPreference: 'high-performance' } as const;

interface Target {
  readonly texture: WebGLTexture;
  readonly framebuffer: WebGLFramebuffer;
  readonly width: number;
  readonly height: number;
}

export class WebGl2Renderer implements EyeRenderer {
  readonly api = 'webgl2';
  readonly sortsItself = false;
  readonly lost: Promise<string>;
  readonly #gl: Gl;
  readonly #rows: RowStore;
  readonly #projection: Projection;
  readonly #splats: Program;
  readonly #resolve: Program;
  readonly #nothing: WebGLVertexArrayObject;
  #target: Target | null = null;

  /**
   * Throws GraphicsError where the browser has no WebGL2, or cannot blend into 16-bit floats. `forHeadset`: on the device that the
   * headset hangs on; a context that is to come there later is lost where that is another one.
   */
  constructor(
    readonly canvas: HTMLCanvasElement,
    readonly forHeadset = false,
  ) {
    const asked: WebGLContextAttributes & { xrCompatible: boolean } = { ...kContext, xrCompatible: forHeadset };
    const gl = canvas.getContext('webgl2', asked);
    if (!gl) throw new GraphicsError(texts.lacks.webgl2);
    const floats = gl.getExtension('EXT_color_buffer_float');
    if (!floats) throw new GraphicsError(texts.lacks.floats);
    this.#gl = gl;
    this.lost = new Promise((resolve) =>
      canvas.addEventListener(
        'webglcontextlost',
        (event) => {
          event.preventDefault();
          resolve('the WebGL context was lost');
        },
        { once: true },
      ),
    );
    this.#rows = new RowStore(gl);
    this.#projection = new Projection(gl);
    this.#splats = new Program(gl, kSplatVertex, kSplatFragment);
    this.#resolve = new Program(gl, kWholeVertex, kResolveFragment);
    this.#nothing = gl.createVertexArray();
  }

  get isLost(): boolean {
    return this.#gl.isContextLost();
  }

  get uploaded(): Uploaded {
    return { ...this.#rows.uploaded, orderBytes: this.#projection.orderBytes };
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
    this.#projection.setOrder(new Uint32Array(0));
  }

  setOrder(order: Uint32Array): void {
    this.#projection.setOrder(order);
  }

  draw(frame: Frame): void {
    fitTo(frame.view, this.canvas);
    this.#drawTo(null, frame);
  }

  async capture(frame: Frame): Promise<Picture> {
    const gl = this.#gl;
    const { width, height } = frame.view;
    const texture = makeTexture(gl, gl.RGBA8, width, height, gl.NEAREST);
    const target = makeTarget(gl, [texture]);
    this.#drawTo(target, frame);
    const bottomUp = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, bottomUp);
    if (gl.isContextLost()) throw new GraphicsError(texts.lacks.lost);
    gl.deleteFramebuffer(target);
    gl.deleteTexture(texture);
    const rgba = new Uint8ClampedArray(bottomUp.length);
    const stride = 4 * width;
    for (let y = 0; y < height; ++y) {
      rgba.set(bottomUp.subarray(y * stride, (y + 1) * stride), (height - 1 - y) * stride);
    }
    return { width, height, rgba };
  }

  async forXr(): Promise<WebGL2RenderingContext> {
    await (this.#gl as Gl & { makeXRCompatible(): Promise<void> }).makeXRCompatible();
    return this.#gl;
  }

  drawEyes(target: WebGLFramebuffer | null, eyes: readonly Eye[], frame: Frame): void {
    for (const { view, x, y } of eyes) this.#drawTo(target, { ...frame, view }, x, y);
  }

  async finish(): Promise<void> {
    // Chromium's gl.finish() waits for nothing, and of a fence it hears milliseconds later. A pixel is there once all of them are.
    const gl = this.#gl;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  }

  dispose(): void {
    this.#gl.getExtension('WEBGL_lose_context')?.loseContext();
  }

  #drawTo(framebuffer: WebGLFramebuffer | null, frame: Frame, x = 0, y = 0): void {
    const gl = this.#gl;
    const target = this.#drawSplats(frame);
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    gl.viewport(x, y, frame.view.width, frame.view.height);
    gl.disable(gl.BLEND);
    this.#resolve.use();
    this.#resolve.sampler('uSplats', 0, target.texture);
    gl.uniform3f(this.#resolve.at('uBackground'), ...blendedBackground(frame.scene));
    gl.uniform1i(this.#resolve.at('uDisplaySpace'), Number(frame.scene.displaySpace));
    gl.bindVertexArray(this.#nothing);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  #drawSplats(frame: Frame): Target {
    const gl = this.#gl;
    const target = this.#targetOf(frame);
    const view = scaledView(frame.view, target.width, target.height);
    this.#projection.run(this.#rows, frame, view);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target.framebuffer);
    gl.viewport(0, 0, target.width, target.height);
    gl.clearBufferfv(gl.COLOR, 0, [0, 0, 0, 0]);
    this.#splats.use();
    this.#projection.bind(this.#splats);
    gl.uniform2f(this.#splats.at('uSize'), view.width, view.height);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.bindVertexArray(this.#nothing);
    gl.drawArrays(gl.TRIANGLES, 0, 3 * this.#projection.count);
    return target;
  }

  #targetOf(frame: Frame): Target {
    const gl = this.#gl;
    const { width, height } = targetSize(frame);
    if (this.#target?.width === width && this.#target.height === height) return this.#target;
    if (this.#target) {
      gl.deleteFramebuffer(this.#target.framebuffer);
      gl.deleteTexture(this.#target.texture);
    }
    const texture = makeTexture(gl, gl.RGBA16F, width, height, gl.LINEAR);
    this.#target = { texture, framebuffer: makeTarget(gl, [texture]), width, height };
    return this.#target;
  }
}
