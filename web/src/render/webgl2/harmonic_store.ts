import type { RowUpdate } from '../../records';
import { Program, makeTarget, makeTexture, type Gl } from './gl';
import { kRowsWide } from './layout';
import { kHarmonicFragment, kHarmonicVertex } from './shaders';

interface Stored {
  readonly texture: WebGLTexture;
  readonly target: WebGLFramebuffer;
  /** Rows of rows. */
  readonly high: number;
}

const kTexelWords = 4;

/** The rows' harmonics, where colors depend on where one looks from: a texture beside those of RowStore. */
export class HarmonicStore {
  #stored: Stored | null = null;
  #texels = 0;
  readonly #scatter: Program;
  readonly #arrays: WebGLVertexArrayObject;
  readonly #rows: WebGLBuffer;
  readonly #words: WebGLBuffer;

  constructor(private readonly gl: Gl) {
    this.#scatter = new Program(gl, kHarmonicVertex, kHarmonicFragment);
    this.#arrays = gl.createVertexArray();
    this.#rows = gl.createBuffer();
    this.#words = gl.createBuffer();
    gl.bindVertexArray(this.#arrays);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.#rows);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribIPointer(0, 1, gl.UNSIGNED_INT, 4, 0);
    gl.enableVertexAttribArray(1);
    gl.bindVertexArray(null);
  }

  /** `instead` is bound where there are no harmonics: a sampler wants a texture. */
  bind(program: Program, unit: number, instead: WebGLTexture): void {
    program.sampler('uHarmonics', unit, this.#stored?.texture ?? instead);
    this.gl.uniform1i(program.at('uHarmonicTexels'), this.#texels);
  }

  /** Bytes uploaded. `high`: rows of rows that there is room for in RowStore. */
  apply(update: RowUpdate, high: number): number {
    const { gl } = this;
    const words = update.harmonics?.words ?? 0;
    if (update.rows.length === 0) return 0;
    this.#reserve(words / kTexelWords, high);
    if (!update.harmonics || !this.#stored) return 0;
    const contents = [
      [this.#rows, update.rows],
      [this.#words, update.harmonics.values],
    ] as const;
    for (const [buffer, array] of contents) {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ARRAY_BUFFER, array, gl.STREAM_DRAW);
    }
    const height = this.#stored.high * this.#texels;
    this.#scatter.use();
    gl.uniform2f(this.#scatter.at('uStoreSize'), kRowsWide, height);
    gl.uniform1ui(this.#scatter.at('uTexels'), this.#texels);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.#stored.target);
    gl.viewport(0, 0, kRowsWide, height);
    gl.disable(gl.BLEND);
    gl.bindVertexArray(this.#arrays);
    for (let texel = 0; texel < this.#texels; ++texel) {
      gl.vertexAttribIPointer(1, kTexelWords, gl.UNSIGNED_INT, 4 * words, 16 * texel);
      gl.uniform1ui(this.#scatter.at('uTexel'), texel);
      gl.drawArrays(gl.POINTS, 0, update.rows.length);
    }
    gl.bindVertexArray(null);
    return update.harmonics.values.byteLength;
  }

  #reserve(texels: number, high: number): void {
    const { gl } = this;
    const before = this.#stored;
    if (texels === this.#texels && (!before || high <= before.high)) return;
    this.#stored = null;
    if (texels > 0) {
      const texture = makeTexture(gl, gl.RGBA32UI, kRowsWide, high * texels, gl.NEAREST);
      this.#stored = { texture, target: makeTarget(gl, [texture]), high };
    }
    if (before && this.#stored && texels === this.#texels) {
      gl.bindFramebuffer(gl.READ_FRAMEBUFFER, before.target);
      gl.bindTexture(gl.TEXTURE_2D, this.#stored.texture);
      gl.copyTexSubImage2D(gl.TEXTURE_2D, 0, 0, 0, 0, 0, kRowsWide, before.high * texels);
    }
    if (before) {
      gl.deleteFramebuffer(before.target);
      gl.deleteTexture(before.texture);
    }
    this.#texels = texels;
  }
}
