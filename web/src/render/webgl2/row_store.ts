import { kRecordWords, type ColorUpdate, type RowUpdate } from '../../records';
import { Program, makeTarget, makeTexture, type Gl } from './gl';
import { HarmonicStore } from './harmonic_store';
import { kRowsWide } from './layout';
import { kKeepFragment, kScatterFragment, kScatterVertex, kWholeVertex } from './shaders';

interface Textures {
  readonly geometry: WebGLTexture;
  readonly appearance: WebGLTexture;
  readonly fade: WebGLTexture;
  /** Colors as they were: those of now are in the appearance. */
  readonly kept: WebGLTexture;
  readonly target: WebGLFramebuffer;
  /** Of what is kept alone: the appearance is read. */
  readonly keepTarget: WebGLFramebuffer;
  readonly high: number;
}

/** The rows, in textures that grow. What is uploaded is what changed: a point a row writes it to its place. */
export class RowStore {
  #textures: Textures;
  readonly #scatter: Program;
  readonly #keep: Program;
  readonly #arrays: WebGLVertexArrayObject;
  readonly #colorArrays: WebGLVertexArrayObject;
  readonly #nothing: WebGLVertexArrayObject;
  readonly #buffers: readonly [WebGLBuffer, WebGLBuffer, WebGLBuffer, WebGLBuffer];
  readonly #harmonics: HarmonicStore;
  readonly uploaded = { rows: 0, bytes: 0 };
  /** Above every row that was ever used. */
  #used = 0;

  constructor(private readonly gl: Gl) {
    this.#scatter = new Program(gl, kScatterVertex, kScatterFragment);
    this.#keep = new Program(gl, kWholeVertex, kKeepFragment);
    this.#nothing = gl.createVertexArray();
    this.#buffers = [gl.createBuffer(), gl.createBuffer(), gl.createBuffer(), gl.createBuffer()];
    this.#arrays = gl.createVertexArray();
    gl.bindVertexArray(this.#arrays);
    const [rows, records, fades, colors] = this.#buffers;
    const integers = (location: number, buffer: WebGLBuffer, words: number, stride: number, offset: number): void => {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.enableVertexAttribArray(location);
      gl.vertexAttribIPointer(location, words, gl.UNSIGNED_INT, stride, offset);
    };
    integers(0, rows, 1, 4, 0);
    integers(1, records, 4, 4 * kRecordWords, 0);
    integers(2, records, 4, 4 * kRecordWords, 16);
    gl.bindBuffer(gl.ARRAY_BUFFER, fades);
    gl.enableVertexAttribArray(3);
    gl.vertexAttribPointer(3, 1, gl.FLOAT, false, 4, 0);
    // Of the appearance the fourth word alone, which the mask leaves to be written.
    this.#colorArrays = gl.createVertexArray();
    gl.bindVertexArray(this.#colorArrays);
    integers(0, rows, 1, 4, 0);
    integers(4, colors, 1, 4, 0);
    gl.bindVertexArray(null);
    // Where an array is not given: of the shader's type.
    for (const location of [1, 2, 4]) gl.vertexAttribI4ui(location, 0, 0, 0, 0);
    this.#textures = this.#make(8);
    this.#harmonics = new HarmonicStore(gl);
  }

  bind(program: Program): void {
    program.sampler('uGeometry', 0, this.#textures.geometry);
    program.sampler('uAppearance', 1, this.#textures.appearance);
    program.sampler('uFade', 2, this.#textures.fade);
    this.#harmonics.bind(program, 5, this.#textures.geometry);
    program.sampler('uKept', 6, this.#textures.kept);
  }

  apply(update: RowUpdate): void {
    let last = -1;
    for (const row of update.rows) last = Math.max(last, row);
    this.#reserve(last + 1);
    this.#used = Math.max(this.#used, last + 1);
    const [rows, records, fades] = this.#buffers;
    const contents = [
      [rows, update.rows],
      [records, update.records],
      [fades, update.fades],
    ] as const;
    this.#draw(contents, this.#arrays, update.rows.length);
    this.uploaded.bytes += this.#harmonics.apply(update, this.#textures.high);
  }

  recolor(update: ColorUpdate): void {
    const { gl } = this;
    const [rows, , , colors] = this.#buffers;
    const contents = [
      [rows, update.rows],
      [colors, update.colors],
    ] as const;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.#textures.target);
    gl.drawBuffers([gl.NONE, gl.COLOR_ATTACHMENT1, gl.NONE, gl.NONE]);
    gl.colorMask(false, false, false, true);
    this.#draw(contents, this.#colorArrays, update.rows.length);
    gl.colorMask(true, true, true, true);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.#textures.target);
    gl.drawBuffers([gl.COLOR_ATTACHMENT0, gl.COLOR_ATTACHMENT1, gl.COLOR_ATTACHMENT2, gl.COLOR_ATTACHMENT3]);
  }

  keepColors(): void {
    const { gl } = this;
    this.#keep.use();
    this.#keep.sampler('uAppearance', 0, this.#textures.appearance);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.#textures.keepTarget);
    gl.viewport(0, 0, kRowsWide, Math.ceil(this.#used / kRowsWide));
    gl.disable(gl.BLEND);
    gl.bindVertexArray(this.#nothing);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.bindVertexArray(null);
  }

  /** Uploads what changed, and writes it to its places. */
  #draw(contents: readonly (readonly [WebGLBuffer, ArrayBufferView])[], arrays: WebGLVertexArrayObject, count: number): void {
    const { gl } = this;
    if (count === 0) return;
    for (const [buffer, array] of contents) {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ARRAY_BUFFER, array, gl.STREAM_DRAW);
      this.uploaded.bytes += array.byteLength;
    }
    this.#scatter.use();
    gl.uniform2f(this.#scatter.at('uStoreSize'), kRowsWide, this.#textures.high);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.#textures.target);
    gl.viewport(0, 0, kRowsWide, this.#textures.high);
    gl.disable(gl.BLEND);
    gl.bindVertexArray(arrays);
    gl.drawArrays(gl.POINTS, 0, count);
    gl.bindVertexArray(null);
    this.uploaded.rows += count;
  }

  clear(): void {
    this.#clear(this.#textures);
    this.#used = 0;
  }

  #clear(textures: Textures): void {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, textures.target);
    gl.clearBufferuiv(gl.COLOR, 0, [0, 0, 0, 0]);
    gl.clearBufferuiv(gl.COLOR, 1, [0, 0, 0, 0]);
    gl.clearBufferfv(gl.COLOR, 2, [0, 0, 0, 0]);
    gl.clearBufferuiv(gl.COLOR, 3, [0, 0, 0, 0]);
  }

  #make(high: number): Textures {
    const { gl } = this;
    const geometry = makeTexture(gl, gl.RGBA32UI, kRowsWide, high, gl.NEAREST);
    const appearance = makeTexture(gl, gl.RGBA32UI, kRowsWide, high, gl.NEAREST);
    const fade = makeTexture(gl, gl.R32F, kRowsWide, high, gl.NEAREST);
    const kept = makeTexture(gl, gl.R32UI, kRowsWide, high, gl.NEAREST);
    const target = makeTarget(gl, [geometry, appearance, fade, kept]);
    const textures = { geometry, appearance, fade, kept, target, keepTarget: makeTarget(gl, [kept]), high };
    this.#clear(textures);
    return textures;
  }

  #reserve(rows: number): void {
    const { gl } = this;
    const before = this.#textures;
    const needed = Math.ceil(rows / kRowsWide);
    if (needed <= before.high) return;
    const most = gl.getParameter(gl.MAX_TEXTURE_SIZE) as number;
    this.#textures = this.#make(Math.min(Math.max(needed, 2 * before.high), most));
    const after = this.#textures;
    const from = gl.createFramebuffer();
    const pairs = [
      [before.geometry, after.geometry],
      [before.appearance, after.appearance],
      [before.fade, after.fade],
      [before.kept, after.kept],
    ] as const;
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, from);
    for (const [source, destination] of pairs) {
      gl.framebufferTexture2D(gl.READ_FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, source, 0);
      gl.bindTexture(gl.TEXTURE_2D, destination);
      gl.copyTexSubImage2D(gl.TEXTURE_2D, 0, 0, 0, 0, 0, kRowsWide, before.high);
    }
    for (const framebuffer of [from, before.target, before.keepTarget]) gl.deleteFramebuffer(framebuffer);
    for (const [source] of pairs) gl.deleteTexture(source);
  }
}
