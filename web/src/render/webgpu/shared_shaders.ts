// What several shaders have in common.

/** Threads of every workgroup. */
export const kThreads = 256;

/** The key of a row that cannot be seen. */
export const kUnseen = 0xffffffff;

export const kView = `
struct View {
  pinhole: vec4f,      // fx, fy, cx, cy
  tangents: vec4f,     // low x, high x, low y, high y
  size: vec2f,
  time: f32,
  rows: u32,
  background: vec3f,
  display_space: u32,
  harmonic_words: u32,  // of a row; 0: colors do not depend on where one looks from
  color_part: f32,      // from the colors that are kept to the records'
  mip: u32,             // Frame.mip
}
@group(0) @binding(0) var<uniform> view: View;
`;

export const kSplat = `
struct Splat {
  centre: vec2f,
  log2_alpha: f32,
  reach: f32,          // white units
  root: vec3f,         // Cholesky factor of the covariance: xu, xv, yv, pixels a white unit
  color: u32,
}
fn color_of(word: u32) -> vec3f {
  return vec3f(vec3u(word, word >> 9, word >> 18) & vec3u(0x1ff)) * exp2(f32(i32(word >> 27) - 24));
}
`;
