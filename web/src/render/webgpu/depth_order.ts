import { bindGroup, computePipeline, type RowBuffers } from './row_buffers';
import { kKeyBits, kProject } from './projection_shader';
import { kThreads } from './shared_shaders';
import { histogramOf, kBlock, kDigitBits, kDigits, reorderOf, scanCountsOf, type Pass } from './sort_shaders';

interface Step {
  readonly pipeline: GPUComputePipeline;
  readonly group: GPUBindGroup;
  /** How many workgroups: one, or what is to be projected, or sorted, by what each takes. */
  readonly over: 'one' | 'projected' | Pass;
}

/** What is projected and sorted in every frame, for rows up to a capacity. */
export class DepthOrder {
  readonly splats: GPUBuffer;
  /** [1] how many rows are seen */
  readonly seen: GPUBuffer;
  /** Seen rows, far to near. */
  readonly order: GPUBuffer;
  /** Of drawIndirect: their triangles. */
  readonly drawArgs: GPUBuffer;
  readonly #sortArgs: GPUBuffer;
  readonly #steps: Step[] = [];
  readonly #buffers: GPUBuffer[] = [];

  constructor(device: GPUDevice, pipelines: DepthPipelines, view: GPUBuffer, rows: RowBuffers, objects: GPUBuffer) {
    const make = (words: number, usage = 0): GPUBuffer => {
      const buffer = device.createBuffer({ size: 4 * words, usage: GPUBufferUsage.STORAGE | usage });
      this.#buffers.push(buffer);
      return buffer;
    };
    const { capacity } = rows;
    this.splats = make(8 * capacity);
    this.seen = make(1);
    this.#sortArgs = make(3, GPUBufferUsage.INDIRECT);
    this.drawArgs = make(4, GPUBufferUsage.INDIRECT);
    const keys = make(capacity);
    const counts = make(kDigits * Math.ceil(capacity / kBlock));
    let from = { keys: make(capacity), rows: make(capacity) };
    let to = { keys, rows: make(capacity) };
    const step = (pipeline: GPUComputePipeline, over: Step['over'], buffers: Readonly<Record<number, GPUBuffer>>): void => {
      this.#steps.push({ pipeline, over, group: bindGroup(device, pipeline, buffers) });
    };
    const { seen } = this;
    step(pipelines.project, 'projected', { 0: view, 1: rows.records, 2: rows.fades, 3: objects, 4: this.splats, 5: keys, 6: rows.harmonics, 7: rows.kept });
    const { first, next } = pipelines;
    step(first.histogram, 'all rows', { 0: view, 2: keys, 3: counts });
    step(first.scanCounts, 'one', { 0: view, 3: counts, 4: seen, 5: this.#sortArgs, 6: this.drawArgs });
    step(first.reorder, 'all rows', { 0: view, 2: keys, 3: counts, 5: from.keys, 6: from.rows });
    for (const shift of pipelines.shifts) {
      step(next.histogram, 'seen rows', { 0: shift, 1: seen, 2: from.keys, 3: counts });
      step(next.scanCounts, 'one', { 1: seen, 3: counts });
      step(next.reorder, 'seen rows', { 0: shift, 1: seen, 2: from.keys, 3: counts, 4: from.rows, 5: to.keys, 6: to.rows });
      [from, to] = [to, from];
    }
    this.order = from.rows;
  }

  encode(commands: GPUCommandEncoder, rows: number): void {
    const pass = commands.beginComputePass();
    for (const { pipeline, group, over } of this.#steps) {
      pass.setPipeline(pipeline);
      pass.setBindGroup(0, group);
      if (over === 'seen rows') pass.dispatchWorkgroupsIndirect(this.#sortArgs, 0);
      else pass.dispatchWorkgroups(over === 'one' ? 1 : Math.ceil(rows / (over === 'projected' ? kThreads : kBlock)));
    }
    pass.end();
  }

  destroy(): void {
    for (const buffer of this.#buffers) buffer.destroy();
  }
}

type SortPipelines = Readonly<Record<'histogram' | 'scanCounts' | 'reorder', GPUComputePipeline>>;

const sortPipelines = (device: GPUDevice, pass: Pass): SortPipelines => ({
  histogram: computePipeline(device, `histogram of ${pass}`, histogramOf(pass)),
  scanCounts: computePipeline(device, `scan counts of ${pass}`, scanCountsOf(pass)),
  reorder: computePipeline(device, `reorder ${pass}`, reorderOf(pass)),
});

/** The shaders, which do not depend on how many rows there are. */
export class DepthPipelines {
  readonly project: GPUComputePipeline;
  readonly first: SortPipelines;
  readonly next: SortPipelines;
  /** [1] of each pass but the first. */
  readonly shifts: readonly GPUBuffer[];

  constructor(device: GPUDevice) {
    this.project = computePipeline(device, 'project', kProject);
    this.first = sortPipelines(device, 'all rows');
    this.next = sortPipelines(device, 'seen rows');
    this.shifts = Array.from({ length: kKeyBits / kDigitBits - 1 }, (_, pass) => {
      const buffer = device.createBuffer({ size: 16, usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST });
      device.queue.writeBuffer(buffer, 0, new Uint32Array([kDigitBits * (pass + 1)]));
      return buffer;
    });
  }
}
