// Makes an instance of splatbus.wasm: the few things of WASI that a C++ library asks for.

const kNotImplemented = 52;
const kMonotonic = 1;

/** @see instantiate.d.mts */
export async function instantiate(source, onGrowth = () => {}) {
  let memory = null;
  const view = () => new DataView(memory.buffer);
  const wasi = {
    clock_time_get(clock, _precision, at) {
      const ms = clock === kMonotonic ? performance.now() : Date.now();
      view().setBigUint64(at, BigInt(Math.round(1e6 * ms)), true);
      return 0;
    },
    environ_sizes_get(count, bytes) {
      view().setUint32(count, 0, true);
      view().setUint32(bytes, 0, true);
      return 0;
    },
    environ_get: () => 0,
    proc_exit(status) {
      throw new Error(`splatbus.wasm ended with ${status}`);
    },
  };
  // Streams, which nothing writes to.
  const named = new Proxy(wasi, { get: (known, name) => known[name] ?? (() => kNotImplemented) });
  const imports = { wasi_snapshot_preview1: named, env: { emscripten_notify_memory_growth: onGrowth } };
  const instance =
    source instanceof WebAssembly.Module
      ? await WebAssembly.instantiate(source, imports)
      : (await (source instanceof Response || source instanceof Promise
          ? WebAssembly.instantiateStreaming(source, imports)
          : WebAssembly.instantiate(source, imports))
        ).instance;
  memory = instance.exports.memory;
  instance.exports._initialize();
  return instance.exports;
}
