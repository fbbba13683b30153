// What the page's WebGL2 and the window's OpenGL 4.5 have in common: GLSL ES 3.00 that is GLSL 4.50 as well. What is drawn
// covers all that a Gaussian can reach: a polygon about the unit circle in the whitened plane, brought to pixels by the Cholesky
// factor of the covariance. Any root of it would do; all have the same area.
const float kBlur = 0.3;
const float kAlphaMin = 1.0 / 255.0;
const float kWhiteScale = 0.8493218002880191;  // alpha = 2^(log2 alpha - |this x|^2)

vec2 signedHalves(uint word) {
  return vec2(ivec2(int(word << 16) >> 16, int(word) >> 16));
}

mat3 rotationOf(vec3 vector) {
  float angle = length(vector);
  float part = angle > 1e-6 ? sin(0.5 * angle) / angle : 0.5;
  vec4 q = vec4(vector * part, cos(0.5 * angle));
  vec3 d = q.xyz + q.xyz;
  vec3 xx = q.x * d, yy = q.y * d, w = q.w * d;
  float zz = q.z * d.z;
  return mat3(1.0 - (yy.y + zz), xx.y + w.z, xx.z - w.y,
              xx.y - w.z, 1.0 - (xx.x + zz), yy.z + w.x,
              xx.z + w.y, yy.z - w.x, 1.0 - (xx.x + yy.y));
}

vec3 colorOf(uint word) {
  uvec3 mantissa = uvec3(word, word >> 9, word >> 18) & 0x1ffu;
  return vec3(mantissa) * exp2(float(int(word >> 27) - 24));
}

// Real spherical harmonics up to degree 3; the first is 1, since colors have it in them.
void harmonicBasis(vec3 d, out float basis[16]) {
  float xx = d.x * d.x, yy = d.y * d.y, zz = d.z * d.z;
  basis = float[16](
    1.0,
    -0.4886025119 * d.y, 0.4886025119 * d.z, -0.4886025119 * d.x,
    1.0925484306 * d.x * d.y, -1.0925484306 * d.y * d.z, 0.3153915653 * (2.0 * zz - xx - yy), -1.0925484306 * d.x * d.z,
    0.5462742153 * (xx - yy),
    -0.5900435899 * d.y * (3.0 * xx - yy), 2.8906114426 * d.x * d.y * d.z, -0.4570457995 * d.y * (4.0 * zz - xx - yy),
    0.3731763326 * d.z * (2.0 * zz - 3.0 * xx - 3.0 * yy), -0.4570457995 * d.x * (4.0 * zz - xx - yy),
    1.4453057213 * d.z * (xx - yy), -0.5900435899 * d.x * (xx - 3.0 * yy));
}

// White units to where alpha falls below kAlphaMin.
float reachOf(float log2Alpha) {
  return sqrt(max(log2Alpha + 7.9943534, 0.0));
}

struct View {
  vec4 pinhole;   // fx, fy, cx, cy
  vec2 size;
  vec4 tangents;  // low x, high x, low y, high y
  bool antialias;
};

// A Gaussian in the picture: pixel = centre + root * (a point of the whitened plane) / kWhiteScale.
struct Splat {
  vec2 centre;      // pixels
  vec3 root;        // Cholesky factor of the covariance: x by the first, x by the second, y by the second
  float log2Alpha;  // in the middle
};

// False where it cannot be seen. `point`: the Gaussian's mean in the camera's frame, beyond the near plane; w: rows of
// camera_from_object; geometry and appearance: its record.
bool splatOf(View view, uvec4 geometry, uvec4 appearance, mat3 w, vec3 point, float opacity, out Splat splat) {
  vec2 tangent = point.xy / point.z;
  vec2 centre = tangent * view.pinhole.xy + view.pinhole.zw;
  tangent = clamp(tangent, view.tangents.xz, view.tangents.yw);
  vec2 j = view.pinhole.xy / point.z;
  mat3 rotation = rotationOf(vec3(signedHalves(appearance.x).y, signedHalves(appearance.y)) * (3.14159265358979 / 32767.0));
  vec3 size = exp(vec3(signedHalves(geometry.w), signedHalves(appearance.x).x) / 1024.0);
  vec3 m0 = ((j.x * (w[0] - tangent.x * w[2])) * rotation) * size;
  vec3 m1 = ((j.y * (w[1] - tangent.y * w[2])) * rotation) * size;
  float a = dot(m0, m0), b = dot(m0, m1), c = dot(m1, m1) + kBlur;
  vec3 minor = cross(m0, m1);
  float sharp = dot(minor, minor);
  float blurred = sharp + kBlur * (a + c);
  a += kBlur;
  if (!(blurred > 0.0 && blurred < 1e30)) return false;
  float alpha = view.antialias ? opacity * sqrt(sharp / blurred) : opacity;
  if (!(alpha >= kAlphaMin)) return false;

  float log2Alpha = log2(alpha);
  vec2 extent = reachOf(log2Alpha) / kWhiteScale * sqrt(vec2(a, c)) + 0.01;
  if (any(lessThan(centre + extent, vec2(0.5))) || any(greaterThan(centre - extent, view.size - 0.5))) return false;

  float rootC = sqrt(c);
  splat = Splat(centre, vec3(sqrt(blurred) / rootC, b / rootC, rootC), log2Alpha);
  return true;
}

// A corner of its polygon. white: where that is in the whitened plane.
vec4 cornerOf(vec2 size, Splat splat, vec2 corner, out vec2 white) {
  white = corner * (reachOf(splat.log2Alpha) + 0.02);
  vec2 offset = vec2(dot(splat.root.xy, white), splat.root.z * white.y) / kWhiteScale;
  vec2 pixel = splat.centre + offset;
  return vec4(2.0 * pixel.x / size.x - 1.0, 1.0 - 2.0 * pixel.y / size.y, 0.0, 1.0);
}
