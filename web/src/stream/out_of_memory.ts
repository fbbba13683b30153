/** Whether this says that memory is at an end: every engine has its own words for it, and wasm.ts has ours. */
export const saysOutOfMemory = (reason: string): boolean => /out of memory|no memory|allocat|invalid (typed )?array length/i.test(reason);
