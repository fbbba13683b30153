// Recorded streams, for the tests that draw them.
import type { Renderer } from '../../src/render/renderer';
import type { Follower, Sorter } from '../../src/stream/wasm';

/** As they come through the WebSocket; in the log both lengths come first. */
export function messagesOf(log: ArrayBuffer): ArrayBuffer[] {
  const view = new DataView(log);
  const messages = [];
  for (let at = 0; at + 8 <= log.byteLength; ) {
    const packet = view.getUint32(at, true);
    const bytes = packet + view.getUint32(at + 4, true);
    const message = new Uint8Array(4 + bytes);
    message.set(new Uint8Array(log, at, 4));
    message.set(new Uint8Array(log, at + 8, bytes), 4);
    messages.push(message.buffer);
    at += 8 + bytes;
  }
  return messages;
}

export function takeRows(follower: Follower, renderer: Renderer, sorter: Sorter): void {
  const changed = follower.takeChanges(1 << 22);
  const harmonics = changed.harmonics && { words: changed.harmonics.words, values: changed.harmonics.values.slice() };
  renderer.apply({ rows: changed.rows.slice(), records: changed.records.slice(), fades: new Float32Array(changed.rows.length), harmonics });
  sorter.update(follower.rowCapacity, changed.rows.slice(), changed.records.slice());
  const colors = follower.takeColors(1 << 22);
  renderer.recolor({ rows: colors.rows.slice(), colors: colors.colors.slice() });
}
