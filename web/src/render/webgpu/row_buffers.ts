import { kRecordWords, type ColorUpdate, type RowUpdate } from '../../records';
import { kKeepColors, kScatterColors, kScatterHarmonics, kScatterRows } from './row_shaders';
import { kThreads } from './shared_shaders';

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

  constructor(private readonly device: GPUDevice) {
    this.#scatterRows = computePipeline(device, 'scatter rows', kScatterRows);
    this.#scatterHarmonics = computePipeline(device, 'scatter harmonics', kScatterHarmonics);
    this.#scatterColors = computePipeline(device, 'scatter colors', kScatterColors);
    this.#keepColors = computePipeline(device, 'keep colors', kKeepColors);
    this.#count = device.createBuffer({ size: 16, usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST });
    this.records = this.#make(kRecordWords);
    this.fades = this.#make(1);
    this.kept = this.#make(1);
    this.harmonics = this.#make(1);
    this.#reserve(16384);
  }

  apply(update: RowUpdate): void {
    let last = -1;
    for (const row of update.rows) last = Math.max(last, row);
    this.used = Math.max(this.used, last + 1);
    this.#reserve(this.used);
    this.#scatter(this.#scatterRows, update.rows.length, {
      0: this.#stage('rows', update.rows),
      1: this.#stage('records', update.records),
      2: this.#stage('fades', update.fades),
      3: this.records,
      4: this.fades,
      6: this.kept,
    });
    this.uploaded.rows += update.rows.length;
    if (update.rows.length > 0) this.#applyHarmonics(update);
  }

  #applyHarmonics({ rows, harmonics }: RowUpdate): void {
    const words = harmonics?.words ?? 0;
    if (words !== this.harmonicWords) {
      this.harmonicWords = words;
      this.harmonics.destroy();
      this.harmonics = this.#make(Math.max(words, 1));
    }
    if (!harmonics) return;
    const staged = { 0: this.#stage('rows', rows, false), 1: this.#stage('harmonics', harmonics.values), 3: this.harmonics };
    this.#scatter(this.#scatterHarmonics, rows.length, staged, words);
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

  #stage(name: string, data: Uint32Array | Float32Array, isNew = true): GPUBuffer {
    let buffer = this.#staging.get(name);
    if (!buffer || buffer.size < data.byteLength) {
      buffer?.destroy();
      const size = Math.max(65536, 2 ** Math.ceil(Math.log2(data.byteLength || 1)));
      buffer = this.device.createBuffer({ label: name, size, usage: GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_DST });
      this.#staging.set(name, buffer);
    }
    if (!isNew) return buffer;
    this.device.queue.writeBuffer(buffer, 0, data as Uint32Array<ArrayBuffer>);
    this.uploaded.bytes += data.byteLength;
    return buffer;
  }

  #make(words: number): GPUBuffer {
    const usage = GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_DST | GPUBufferUsage.COPY_SRC;
    return this.device.createBuffer({ size: 4 * words * Math.max(this.capacity, 1), usage });
  }

  #reserve(rows: number): void {
    if (rows <= this.capacity) return;
    const widest = Math.max(kRecordWords, this.harmonicWords);
    const most = Math.floor(this.device.limits.maxStorageBufferBindingSize / (4 * widest));
    this.capacity = Math.min(Math.max(rows, 2 * this.capacity), most);
    const before = [this.records, this.fades, this.kept, this.harmonics];
    this.records = this.#make(kRecordWords);
    this.fades = this.#make(1);
    this.kept = this.#make(1);
    this.harmonics = this.#make(Math.max(this.harmonicWords, 1));
    const commands = this.device.createCommandEncoder();
    [this.records, this.fades, this.kept, this.harmonics].forEach((after, i) => commands.copyBufferToBuffer(before[i], 0, after, 0, before[i].size));
    this.device.queue.submit([commands.finish()]);
    for (const buffer of before) buffer.destroy();
  }
}
