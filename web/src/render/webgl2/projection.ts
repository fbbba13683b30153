import { cameraFromObjects, kTransformFloats, type View } from '../../math';
import { tangentLimits, type Frame } from '../renderer';
import { Program, makeTarget, makeTexture, type Gl } from './gl';
import { kOrderWidth } from './layout';
import { kProjectFragment } from './projection_shader';
import type { RowStore } from './row_store';
import { kWholeVertex } from './shaders';

/** Objects a row of their texture: three texels each, within what every device takes. */
const kObjectsWide = 512;

/** Of each rank of an order, far to near, the row and what its triangle needs. */
interface Ranks {
  readonly order: WebGLTexture;
  readonly low: WebGLTexture;
  readonly high: WebGLTexture;
  readonly target: WebGLFramebuffer;
  readonly rows: number;
}

/** Projects the rows of an order, each once in every picture: a pixel of two textures a Gaussian. */
export class Projection {
  readonly #project: Program;
  readonly #nothing: WebGLVertexArrayObject;
  #ranks: Ranks;
  #count = 0;
  /** That setOrder() has uploaded so far. */
  orderBytes = 0;
  #objects: { texture: WebGLTexture; rows: number };
  #objectFloats = new Float32Array(0);

  constructor(private readonly gl: Gl) {
    this.#project = new Program(gl, kWholeVertex, kProjectFragment);
    this.#nothing = gl.createVertexArray();
    this.#ranks = this.#makeRanks(8);
    this.#objects = this.#makeObjects(1);
  }

  /** Of the order. */
  get count(): number {
    return this.#count;
  }

  setOrder(order: Uint32Array): void {
    const { gl } = this;
    this.#count = order.length;
    const rows = Math.ceil(order.length / kOrderWidth);
    if (rows > this.#ranks.rows) {
      const before = this.#ranks;
      gl.deleteFramebuffer(before.target);
      for (const texture of [before.order, before.low, before.high]) gl.deleteTexture(texture);
      this.#ranks = this.#makeRanks(Math.max(rows, 2 * before.rows));
    }
    gl.bindTexture(gl.TEXTURE_2D, this.#ranks.order);
    const whole = Math.floor(order.length / kOrderWidth);
    const upload = (y: number, width: number, height: number): void => {
      if (width * height === 0) return;
      gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, y, width, height, gl.RED_INTEGER, gl.UNSIGNED_INT, order, y * kOrderWidth);
    };
    upload(0, kOrderWidth, whole);
    upload(whole, order.length - whole * kOrderWidth, 1);
    this.orderBytes += order.byteLength;
  }

  /** `view`: of `frame`, in pixels of the splats' own target. */
  run(rows: RowStore, frame: Frame, view: View): void {
    const { gl } = this;
    this.#uploadObjects(frame);
    const program = this.#project;
    program.use();
    rows.bind(program);
    program.sampler('uOrder', 3, this.#ranks.order);
    program.sampler('uObjects', 4, this.#objects.texture);
    gl.uniform1i(program.at('uCount'), this.#count);
    gl.uniform1i(program.at('uObjectsWide'), kObjectsWide);
    gl.uniform4f(program.at('uPinhole'), view.fx, view.fy, view.cx, view.cy);
    gl.uniform2f(program.at('uSize'), view.width, view.height);
    gl.uniform4f(program.at('uTangents'), ...tangentLimits(view));
    gl.uniform1f(program.at('uTime'), frame.timeS);
    gl.uniform1f(program.at('uColorPart'), frame.colorPart);
    gl.uniform1i(program.at('uMip'), Number(frame.mip));
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.#ranks.target);
    gl.viewport(0, 0, kOrderWidth, Math.ceil(this.#count / kOrderWidth));
    gl.disable(gl.BLEND);
    gl.bindVertexArray(this.#nothing);
    if (this.#count > 0) gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  bind(program: Program): void {
    program.sampler('uLow', 0, this.#ranks.low);
    program.sampler('uHigh', 1, this.#ranks.high);
  }

  #makeRanks(rows: number): Ranks {
    const { gl } = this;
    const make = (format: number): WebGLTexture => makeTexture(gl, format, kOrderWidth, rows, gl.NEAREST);
    const [order, low, high] = [make(gl.R32UI), make(gl.RGBA32UI), make(gl.RGBA32UI)];
    return { order, low, high, target: makeTarget(gl, [low, high]), rows };
  }

  #makeObjects(rows: number): { texture: WebGLTexture; rows: number } {
    const { gl } = this;
    this.#objectFloats = new Float32Array(rows * kObjectsWide * kTransformFloats);
    return { texture: makeTexture(gl, gl.RGBA32F, 3 * kObjectsWide, rows, gl.NEAREST), rows };
  }

  #uploadObjects(frame: Frame): void {
    const { gl } = this;
    const count = frame.scene.transforms.length / kTransformFloats;
    if (count === 0) return;
    const rows = Math.ceil(count / kObjectsWide);
    if (rows > this.#objects.rows) {
      gl.deleteTexture(this.#objects.texture);
      this.#objects = this.#makeObjects(rows);
    }
    cameraFromObjects(frame.view, frame.scene.transforms, frame.scene.farField, this.#objectFloats);
    gl.bindTexture(gl.TEXTURE_2D, this.#objects.texture);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, 3 * Math.min(count, kObjectsWide), rows, gl.RGBA, gl.FLOAT, this.#objectFloats);
  }
}
