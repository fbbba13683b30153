// Holds where rows are, and sorts them for the newest view; rows and the order that knows them leave together.
import { transfersOf, type SceneBatch, type Sorted, type ToSortWorker, type WorkerScope } from './messages';
import { loadWasm, Sorter } from './wasm';

const scope = self as unknown as WorkerScope<ToSortWorker, Sorted>;
const loaded = loadWasm('splatbus.wasm').then((wasm) => new Sorter(wasm));
let view: Float32Array | null = null;
/** Something has come: before that an order would be of no rows, and take away the picture that stands. */
let begun = false;
let capacity = 0;
let waiting: SceneBatch[] = [];
let due = false;
// A message to itself comes after those that are there already: of several views only the last is sorted for.
const turn = new MessageChannel();

function sortSoon(): void {
  if (due || !view || !begun) return;
  due = true;
  turn.port2.postMessage(null);
}

function apply(sorter: Sorter, batch: SceneBatch): void {
  const { rows, records } = batch.update;
  capacity = rows.reduce((most, row) => Math.max(most, row + 1), capacity);
  sorter.update(capacity, rows, records);
  sorter.setTransforms(batch.scene.transforms, batch.scene.farField);
  waiting.push(batch);
  begun = true;
  sortSoon();
}

/** What goes wrong once the sorter is there is the worker's own end, which the page hears of; in a promise it would not. */
function withSorter(use: (sorter: Sorter) => void): void {
  const fail = (error: unknown): void => {
    setTimeout(() => {
      throw error;
    });
  };
  void loaded.then(use).catch(fail);
}

function sort(sorter: Sorter): void {
  due = false;
  if (!view) return;
  const start = performance.now();
  const order = sorter.sort(view).slice();
  const sorted = { batches: waiting, order, milliseconds: performance.now() - start };
  waiting = [];
  scope.postMessage(sorted, [order.buffer, ...sorted.batches.flatMap(transfersOf)]);
}

turn.port1.onmessage = () => withSorter(sort);

scope.onmessage = ({ data }) => {
  if (data.kind === 'view') {
    view = new Float32Array(data.viewFromWorld);
    sortSoon();
    return;
  }
  data.port.onmessage = (event: MessageEvent<SceneBatch>) => withSorter((sorter) => apply(sorter, event.data));
};
