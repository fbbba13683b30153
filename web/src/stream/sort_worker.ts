// Holds where rows are, and sorts them for the newest view; rows and the order that knows them leave together.
import { DepthSorter } from './depth_sorter';
import { transfersOf, type SceneBatch, type Sorted, type ToSortWorker, type WorkerScope } from './messages';

const scope = self as unknown as WorkerScope<ToSortWorker, Sorted>;
const sorter = new DepthSorter();
let view: Float64Array | null = null;
let waiting: SceneBatch[] = [];
let due = false;
// A message to itself comes after those that are there already: of several views only the last is sorted for.
const turn = new MessageChannel();

function sortSoon(): void {
  if (due || !view) return;
  due = true;
  turn.port2.postMessage(null);
}

turn.port1.onmessage = () => {
  due = false;
  if (!view) return;
  const start = performance.now();
  const order = sorter.sort(view);
  const sorted = { batches: waiting, order, milliseconds: performance.now() - start };
  waiting = [];
  scope.postMessage(sorted, [order.buffer, ...sorted.batches.flatMap(transfersOf)]);
};

scope.onmessage = ({ data }) => {
  if (data.kind === 'view') {
    view = data.viewFromWorld;
    sortSoon();
    return;
  }
  data.port.onmessage = (event: MessageEvent<SceneBatch>) => {
    sorter.apply(event.data);
    waiting.push(event.data);
    sortSoon();
  };
};
