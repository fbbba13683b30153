import { bindGroup, computePipeline, type RowBuffers } from './row_buffers';
import { kKeyBits, kProject } from './projection_shader';
import { kThreads } from './shared_shaders';
import { kBlock, kCloseUp, kCountSeen, kDigitBits, kDigits, kHistogram, kReorder, kScanCounts } from './sort_shaders';

interface Step {
  readonly pipeline: GPUComputePipeline;
  readonly group: GPUBindGroup;
  /** One workgroup; one for every kThreads rows; or one for every kBlock of the seen. */
  readonly over: 'one' | 'rows' | 'seen';
}

/** What is projected and sorted in every frame, for rows up to a capacity. */
export class DepthOrder {
  readonly splats: GPUBuffer;
  /** [1] how many rows are seen */
  readonly seen: GPUBuffer;
  /** Seen rows, far to near. */
  readonly order: GPUBuffer;
  /** Of drawIndexedIndirect: their quads. */
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
    this.drawArgs = make(5, GPUBufferUsage.INDIRECT);
    const keys = make(capacity);
    const blockCounts = make(Math.ceil(capacity / kThreads));
    const counts = make(kDigits * Math.ceil(capacity / kBlock));
    let from = { keys: make(capacity), rows: make(capacity) };
    let to = { keys: make(capacity), rows: make(capacity) };
    const step = (pipeline: GPUComputePipeline, over: Step['over'], buffers: Readonly<Record<number, GPUBuffer>>): void => {
      this.#steps.push({ pipeline, over, group: bindGroup(device, pipeline, buffers) });
    };
    const { seen } = this;
    step(pipelines.project, 'rows', { 0: view, 1: rows.records, 2: rows.fades, 3: objects, 4: this.splats, 5: keys, 6: blockCounts, 7: rows.harmonics });
    step(pipelines.countSeen, 'one', { 0: view, 1: blockCounts, 2: seen, 3: this.#sortArgs, 4: this.drawArgs });
    step(pipelines.closeUp, 'rows', { 0: view, 1: keys, 2: blockCounts, 3: from.keys, 4: from.rows });
    for (const shift of pipelines.shifts) {
      step(pipelines.histogram, 'seen', { 0: shift, 1: seen, 2: from.keys, 3: counts });
      step(pipelines.scanCounts, 'one', { 1: seen, 3: counts });
      step(pipelines.reorder, 'seen', { 0: shift, 1: seen, 2: from.keys, 3: counts, 4: from.rows, 5: to.keys, 6: to.rows });
      [from, to] = [to, from];
    }
    this.order = from.rows;
  }

  encode(commands: GPUCommandEncoder, rows: number): void {
    const pass = commands.beginComputePass();
    for (const { pipeline, group, over } of this.#steps) {
      pass.setPipeline(pipeline);
      pass.setBindGroup(0, group);
      if (over === 'seen') pass.dispatchWorkgroupsIndirect(this.#sortArgs, 0);
      else pass.dispatchWorkgroups(over === 'one' ? 1 : Math.max(1, Math.ceil(rows / kThreads)));
    }
    pass.end();
  }

  destroy(): void {
    for (const buffer of this.#buffers) buffer.destroy();
  }
}

/** The shaders, which do not depend on how many rows there are. */
export class DepthPipelines {
  readonly project: GPUComputePipeline;
  readonly countSeen: GPUComputePipeline;
  readonly closeUp: GPUComputePipeline;
  readonly histogram: GPUComputePipeline;
  readonly scanCounts: GPUComputePipeline;
  readonly reorder: GPUComputePipeline;
  /** [1] of each pass of the sort. */
  readonly shifts: readonly GPUBuffer[];

  constructor(device: GPUDevice) {
    this.project = computePipeline(device, 'project', kProject);
    this.countSeen = computePipeline(device, 'count seen', kCountSeen);
    this.closeUp = computePipeline(device, 'close up', kCloseUp);
    this.histogram = computePipeline(device, 'histogram', kHistogram);
    this.scanCounts = computePipeline(device, 'scan counts', kScanCounts);
    this.reorder = computePipeline(device, 'reorder', kReorder);
    this.shifts = Array.from({ length: kKeyBits / kDigitBits }, (_, pass) => {
      const buffer = device.createBuffer({ size: 16, usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST });
      device.queue.writeBuffer(buffer, 0, new Uint32Array([kDigitBits * pass]));
      return buffer;
    });
  }
}
