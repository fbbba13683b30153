// Changed rows to where they belong, so that what is uploaded is what changed.
import { kThreads } from './shared_shaders';

export const kScatterRows = `
@group(0) @binding(0) var<storage, read> rows: array<u32>;
@group(0) @binding(1) var<storage, read> changed: array<vec4u>;
@group(0) @binding(2) var<storage, read> changed_fades: array<f32>;
@group(0) @binding(3) var<storage, read_write> records: array<vec4u>;
@group(0) @binding(4) var<storage, read_write> fades: array<f32>;
@group(0) @binding(5) var<uniform> count: u32;
@group(0) @binding(6) var<storage, read_write> kept: array<u32>;
@compute @workgroup_size(${kThreads}) fn main(@builtin(global_invocation_id) id: vec3u) {
  if (id.x >= count) { return; }
  let row = rows[id.x];
  records[2 * row] = changed[2 * id.x];
  records[2 * row + 1] = changed[2 * id.x + 1];
  fades[row] = changed_fades[id.x];
  kept[row] = changed[2 * id.x + 1].w;
}`;

export const kScatterColors = `
@group(0) @binding(0) var<storage, read> rows: array<u32>;
@group(0) @binding(1) var<storage, read> changed: array<u32>;
@group(0) @binding(3) var<storage, read_write> records: array<vec4u>;
@group(0) @binding(5) var<uniform> count: u32;
@compute @workgroup_size(${kThreads}) fn main(@builtin(global_invocation_id) id: vec3u) {
  if (id.x >= count) { return; }
  records[2 * rows[id.x] + 1].w = changed[id.x];
}`;

/** Of all rows. */
export const kKeepColors = `
@group(0) @binding(3) var<storage, read> records: array<vec4u>;
@group(0) @binding(5) var<uniform> count: u32;
@group(0) @binding(6) var<storage, read_write> kept: array<u32>;
@compute @workgroup_size(${kThreads}) fn main(@builtin(global_invocation_id) id: vec3u) {
  if (id.x >= count) { return; }
  kept[id.x] = records[2 * id.x + 1].w;
}`;

export const kScatterHarmonics = `
@group(0) @binding(0) var<storage, read> rows: array<u32>;
@group(0) @binding(1) var<storage, read> changed: array<u32>;
@group(0) @binding(3) var<storage, read_write> harmonics: array<u32>;
@group(0) @binding(5) var<uniform> count: vec2u;  // rows, words of each
@compute @workgroup_size(${kThreads}) fn main(@builtin(global_invocation_id) id: vec3u) {
  if (id.x >= count.x) { return; }
  for (var k = 0u; k < count.y; k++) { harmonics[count.y * rows[id.x] + k] = changed[count.y * id.x + k]; }
}`;
