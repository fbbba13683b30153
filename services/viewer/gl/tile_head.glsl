// Where a splat reaches, in tiles of the picture.
const uint kTileSide = 16u;

Splat splatAt(uvec4 low, uvec4 high) {
  vec4 first = uintBitsToFloat(low);
  return Splat(first.xy, vec3(first.zw, uintBitsToFloat(high.x)), uintBitsToFloat(high.y));
}

// As far as its quad.
float whiteRadiusOf(Splat splat) {
  return reachOf(splat.log2Alpha) + 0.02;
}

// y from and to of all that it reaches, pixels.
vec2 heightOf(Splat splat, float radius) {
  float half_height = splat.root.z * radius / kWhiteScale;
  return splat.centre.y + vec2(-half_height, half_height);
}

// x from and to of what it reaches between two y's, at least one of which is no farther than that.
vec2 widthOf(Splat splat, float radius, vec2 between) {
  vec2 second = clamp((between - splat.centre.y) * (kWhiteScale / splat.root.z), -radius, radius);
  float rightmost = radius * splat.root.y / length(splat.root.xy);
  vec2 at = clamp(vec2(-rightmost, rightmost), second.x, second.y);  // where it is widest to the left, to the right
  vec2 first = vec2(-1.0, 1.0) * sqrt(max(radius * radius - at * at, 0.0));
  return splat.centre.x + (splat.root.x * first + splat.root.y * at) / kWhiteScale;
}

// The first pixel and the one behind the last whose middles lie from low to high.
ivec2 pixelsOf(vec2 range, uint most) {
  vec2 bounded = clamp(range, vec2(-1.0), vec2(float(most) + 1.0));
  return clamp(ivec2(ceil(bounded.x - 0.5), floor(bounded.y - 0.5) + 1.0), ivec2(0), ivec2(int(most)));
}

// The rows of tiles that it touches, from and to behind the last.
uvec2 tileRowsOf(Splat splat, float radius, uvec2 pixels) {
  ivec2 rows = pixelsOf(heightOf(splat, radius), pixels.y);
  if (rows.x >= rows.y) return uvec2(0u);
  return uvec2(uint(rows.x) / kTileSide, (uint(rows.y) + kTileSide - 1u) / kTileSide);
}

// In one of those, the tiles.
uvec2 tilesOf(Splat splat, float radius, uvec2 pixels, uint row) {
  float top = float(row * kTileSide) + 0.5;
  ivec2 columns = pixelsOf(widthOf(splat, radius, vec2(top, top + float(kTileSide - 1u))), pixels.x);
  if (columns.x >= columns.y) return uvec2(0u);
  return uvec2(uint(columns.x) / kTileSide, (uint(columns.y) + kTileSide - 1u) / kTileSide);
}
