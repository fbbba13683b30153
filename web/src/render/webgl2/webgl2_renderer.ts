import { cameraFromObjects, kTransformFloats, scaledView } from '../../math';
import type { ColorUpdate, RowUpdate } from '../../records';
import { batchIndices, kBatch } from '../quads';
import { blendedBackground, fitTo, GraphicsError, tangentLimits, targetSize, type Eye, type EyeRenderer, type Frame, type Picture } from '../renderer';
import { Program, makeTarget, makeTexture, type Gl } from './gl';
import { kOrderWidth } from './layout';
import { RowStore } from './row_store';
import { kResolveFragment, kResolveVertex, kSplatFragment, kSplatVertex } from './shaders';

interface Target {
  readonly texture: WebGLTexture;
  readonly framebuffer: WebGLFramebuffer;
  readonly width: number;
  readonly height: number;
}

/** Objects a row of their texture: three texels each, within what every device takes. */
const kObjectsWide = 512;

export class WebGl2Renderer implements EyeRenderer {
  readonly api = 'webgl2';
  readonly sortsItself = false;
  readonly lost: Promise<string>;
  readonly #gl: Gl;
  readonly #rows: RowStore;
  readonly #splats: Program;
  readonly #resolve: Program;
  readonly #quads: WebGLVertexArrayObject;
  readonly #nothing: WebGLVertexArrayObject;
  #order: { texture: WebGLTexture; high: number };
  #count = 0;
  #objects: { texture: WebGLTexture; high: number };
  #objectFloats = new Float32Array(0);
  #target: Target | null = null;

  /** Throws GraphicsError where the browser has no WebGL2, or cannot blend into 16-bit floats. */
  constructor(readonly canvas: HTMLCanvasElement) {
    const gl = canvas.getContext('webgl2', { alpha: false, antialias: false, depth: false, powerPreference: 'high-performance' });
    if (!gl) throw new GraphicsError('WebGL2 is not available');
    const floats = gl.getExtension('EXT_color_buffer_float');
    if (!floats) throw new GraphicsError('the graphics driver cannot draw into 16-bit floats');
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
    this.#splats = new Program(gl, kSplatVertex, kSplatFragment);
    this.#resolve = new Program(gl, kResolveVertex, kResolveFragment);
    this.#nothing = gl.createVertexArray();
    this.#quads = gl.createVertexArray();
    gl.bindVertexArray(this.#quads);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, batchIndices(), gl.STATIC_DRAW);
    gl.bindVertexArray(null);
    this.#order = this.#makeOrder(8);
    this.#objects = this.#makeObjects(1);
  }

  get uploaded(): { rows: number; bytes: number } {
    return this.#rows.uploaded;
  }

  apply(update: RowUpdate): void {
    this.#rows.apply(update);
  }

  recolor(update: ColorUpdate): void {
    this.#rows.recolor(update);
  }

  clear(): void {
    this.#rows.clear();
    this.#count = 0;
  }

  setOrder(order: Uint32Array): void {
    const gl = this.#gl;
    this.#count = order.length;
    const high = Math.ceil(order.length / kOrderWidth);
    if (high > this.#order.high) {
      gl.deleteTexture(this.#order.texture);
      this.#order = this.#makeOrder(Math.max(high, 2 * this.#order.high));
    }
    gl.bindTexture(gl.TEXTURE_2D, this.#order.texture);
    const whole = Math.floor(order.length / kOrderWidth);
    const upload = (y: number, width: number, height: number): void => {
      if (width * height === 0) return;
      gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, y, width, height, gl.RED_INTEGER, gl.UNSIGNED_INT, order, y * kOrderWidth);
    };
    upload(0, kOrderWidth, whole);
    upload(whole, order.length - whole * kOrderWidth, 1);
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
    this.#gl.finish();
  }

  dispose(): void {
    this.#gl.getExtension('WEBGL_lose_context')?.loseContext();
  }

  #makeOrder(high: number): { texture: WebGLTexture; high: number } {
    return { texture: makeTexture(this.#gl, this.#gl.R32UI, kOrderWidth, high, this.#gl.NEAREST), high };
  }

  #makeObjects(high: number): { texture: WebGLTexture; high: number } {
    this.#objectFloats = new Float32Array(high * kObjectsWide * kTransformFloats);
    return { texture: makeTexture(this.#gl, this.#gl.RGBA32F, 3 * kObjectsWide, high, this.#gl.NEAREST), high };
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
    this.#uploadObjects(frame);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target.framebuffer);
    gl.viewport(0, 0, target.width, target.height);
    gl.clearBufferfv(gl.COLOR, 0, [0, 0, 0, 0]);
    const program = this.#splats;
    program.use();
    this.#rows.bind(program);
    program.sampler('uOrder', 3, this.#order.texture);
    program.sampler('uObjects', 4, this.#objects.texture);
    gl.uniform1i(program.at('uCount'), this.#count);
    gl.uniform1i(program.at('uObjectsWide'), kObjectsWide);
    gl.uniform4f(program.at('uPinhole'), view.fx, view.fy, view.cx, view.cy);
    gl.uniform2f(program.at('uSize'), view.width, view.height);
    gl.uniform4f(program.at('uTangents'), ...tangentLimits(view));
    gl.uniform1f(program.at('uTime'), frame.timeS);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.bindVertexArray(this.#quads);
    gl.drawElementsInstanced(gl.TRIANGLES, 6 * kBatch, gl.UNSIGNED_SHORT, 0, Math.ceil(this.#count / kBatch));
    return target;
  }

  #uploadObjects(frame: Frame): void {
    const gl = this.#gl;
    const high = Math.max(1, Math.ceil(frame.scene.transforms.length / kTransformFloats / kObjectsWide));
    if (high > this.#objects.high) {
      gl.deleteTexture(this.#objects.texture);
      this.#objects = this.#makeObjects(high);
    }
    cameraFromObjects(frame.view, frame.scene.transforms, frame.scene.farField, this.#objectFloats);
    gl.bindTexture(gl.TEXTURE_2D, this.#objects.texture);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, 3 * kObjectsWide, high, gl.RGBA, gl.FLOAT, this.#objectFloats);
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
