import { kRecordWords, type ColorUpdate, type RowUpdate } from '../../records';
import { kKeepColors, kScatterColors, kScatterHarmonics, kScatterRows } from './row_shaders';
import { kThreads } from './shared_shaders';

/** Rows that are uploaded at once: what they are uploaded to stays. */
const kStagedRows = 65536;

/** A pipeline of one shader that computes. */
export function computePipeline(device: GPUDevice, label: string, code: string): GPUComputePipeline {
  const module = device.createShaderModule({ label, code });
  return device.createComputePipeline({ label, layout: 'auto', compute: { module, entryPoint: 'main' } });
}

/** Buffers by their binding, as the first group of a pipeline. */
export function bindGroup(
  device: GPUDevice,
  pipeline: GPUComputePipeline | GPURenderPipeline,
  resources: Readonly<Record<number, GPUBuffer | GPUTextureView | GPUSampler>>,
): GPUBindGroup {
  const entries = Object.entries(resources).map(([binding, resource]) => ({
    binding: Number(binding),
    resource: resource instanceof GPUBuffer ? { buffer: resource } : resource,
  }));
  return device.createBindGroup({ layout: pipeline.getBindGroupLayout(0), entries });
}

/** The rows, in buffers that grow. Lists of what changed are uploaded and written to their places there. */
export class RowBuffers {
  readonly uploaded = { rows: 0, bytes: 0 };
  capacity = 0;
  /** Above every row that was ever used. */
  used = 0;
  records: GPUBuffer;
  fades: GPUBuffer;
  /** Colors as they were: those of now are in the records. */
  kept: GPUBuffer;
  /** [capacity][harmonicWords]; something where there are none. */
  harmonics: GPUBuffer;
  harmonicWords = 0;
  readonly #scatterHarmonics: GPUComputePipeline;
  readonly #scatterRows: GPUComputePipeline;
  readonly #scatterColors: GPUComputePipeline;
  readonly #keepColors: GPUComputePipeline;
  readonly #staging = new Map<string, GPUBuffer>();
  readonly #count: GPUBuffer;

  /** `fail` hears why rows cannot be held. */
  constructor(
    private readonly device: GPUDevice,
    private readonly fail: (reason: string) => void,
  ) {
    this.#scatterRows = computePipeline(device, 'scatter rows', kScatterRows);
    this.#scatterHarmonics = computePipeline(device, 'scatter harmonics', kScatterHarmonics);
    this.#scatterColors = computePipeline(device, 'scatter colors', kScatterColors);
    this.#keepColors = computePipeline(device, 'keep colors', kKeepColors);
    this.#count = device.createBuffer({ size: 16, usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST });
    this.records = this.#make(kRecordWords);
    this.fades = this.#make(1);
    this.kept = this.#make(1);
    this.harmonics = this.#make(1);
    this.#reserve(16384, 0);
  }

  apply(update: RowUpdate): void {
    let last = -1;
    for (const row of update.rows) last = Math.max(last, row);
    if (last < 0) return;
    const used = Math.max(this.used, last + 1);
    if (!this.#reserve(used, update.harmonics?.words ?? 0)) return;
    this.used = used;
    for (let from = 0; from < update.rows.length; from += kStagedRows) this.#write(update, from, from + kStagedRows);
    this.uploaded.rows += update.rows.length;
  }

  #write({ rows, records, fades, harmonics }: RowUpdate, from: number, to: number): void {
    const some = rows.subarray(from, to);
    const staged = this.#stage('rows', some);
    this.#scatter(this.#scatterRows, some.length, {
      0: staged,
      1: this.#stage('records', records.subarray(kRecordWords * from, kRecordWords * to)),
      2: this.#stage('fades', fades.subarray(from, to)),
      3: this.records,
      4: this.fades,
      6: this.kept,
    });
    if (!harmonics) return;
    const { words, values } = harmonics;
    const buffers = { 0: staged, 1: this.#stage('harmonics', values.subarray(words * from, words * to)), 3: this.harmonics };
    this.#scatter(this.#scatterHarmonics, some.length, buffers, words);
  }

  recolor(update: ColorUpdate): void {
    this.#scatter(this.#scatterColors, update.rows.length, {
      0: this.#stage('rows', update.rows),
      1: this.#stage('colors', update.colors),
      3: this.records,
    });
    this.uploaded.rows += update.rows.length;
  }

  keepColors(): void {
    this.#scatter(this.#keepColors, this.used, { 3: this.records, 6: this.kept });
  }

  clear(): void {
    const commands = this.device.createCommandEncoder();
    commands.clearBuffer(this.records);
    this.device.queue.submit([commands.finish()]);
    this.used = 0;
  }

  #scatter(pipeline: GPUComputePipeline, count: number, buffers: Readonly<Record<number, GPUBuffer>>, words = 0): void {
    if (count === 0) return;
    this.device.queue.writeBuffer(this.#count, 0, new Uint32Array([count, words]));
    const commands = this.device.createCommandEncoder();
    const pass = commands.beginComputePass();
    pass.setPipeline(pipeline);
    pass.setBindGroup(0, bindGroup(this.device, pipeline, { ...buffers, 5: this.#count }));
    pass.dispatchWorkgroups(Math.ceil(count / kThreads));
    pass.end();
    this.device.queue.submit([commands.finish()]);
  }

  #stage(name: string, data: Uint32Array | Float32Array): GPUBuffer {
    let buffer = this.#staging.get(name);
    if (!buffer || buffer.size < data.byteLength) {
      buffer?.destroy();
      const size = Math.max(65536, 2 ** Math.ceil(Math.log2(data.byteLength || 1)));
      buffer = this.device.createBuffer({ label: name, size, usage: GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_DST });
      this.#staging.set(name, buffer);
    }
    this.device.queue.writeBuffer(buffer, 0, data as Uint32Array<ArrayBuffer>);
    this.uploaded.bytes += data.byteLength;
    return buffer;
  }

  #make(words: number): GPUBuffer {
    const usage = GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_DST | GPUBufferUsage.COPY_SRC;
    return this.device.createBuffer({ size: 4 * words * Math.max(this.capacity, 1), usage });
  }

  /** Room for so many rows, of so many words of harmonics each; false where the device cannot have it. */
  #reserve(rows: number, words: number): boolean {
    if (rows <= this.capacity && words === this.harmonicWords) return true;
    // Whatever is kept by the row is bound whole. Of what DepthOrder keeps nothing is wider than a record.
    const { maxStorageBufferBindingSize, maxBufferSize } = this.device.limits;
    const most = Math.floor(Math.min(maxStorageBufferBindingSize, maxBufferSize) / (4 * Math.max(kRecordWords, words)));
    if (rows > most) {
      this.fail(`the device holds ${most} rows, and there are ${rows}`);
      return false;
    }
    const capacity = Math.min(rows > this.capacity ? Math.max(rows, 2 * this.capacity) : this.capacity, most);
    const moves = capacity !== this.capacity;
    const sameKind = words === this.harmonicWords;
    this.capacity = capacity;
    this.harmonicWords = words;
    if (moves) {
      this.records = this.#moved(this.records, kRecordWords);
      this.fades = this.#moved(this.fades, 1);
      this.kept = this.#moved(this.kept, 1);
    }
    if (moves || !sameKind) this.harmonics = this.#moved(this.harmonics, Math.max(words, 1), sameKind);
    return true;
  }

  /** A buffer of the new capacity in place of this one, with what was in it. */
  #moved(before: GPUBuffer, words: number, keep = true): GPUBuffer {
    const after = this.#make(words);
    if (keep) {
      const commands = this.device.createCommandEncoder();
      commands.copyBufferToBuffer(before, 0, after, 0, Math.min(before.size, after.size));
      this.device.queue.submit([commands.finish()]);
    }
    before.destroy();
    return after;
  }
}
