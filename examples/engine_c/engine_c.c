/* An engine of one sphere, 1 m in radius about the origin, under a sun and a grey sky: answers every camera that is
 * asked for. Build it with `cc engine_c.c $(pkg-config --cflags --libs splatbus-engine) -lm`, or the CMakeLists.txt
 * beside it, and start it from a launch file (`program: /where/engine_c`): that appends `--bus ADDRESS --name NAME`.
 * It answers no request for light maps: give the trainer `pair_visibility: false`, and start no relight. */
#include <math.h>
#include <splatbus/engine.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

static const float sun[3] = {0.48f, 0.8f, 0.36f}, albedo[3] = {0.8f, 0.4f, 0.2f};
static const float irradiance = 2, sky = 0.3f; /* of the sun; radiance of the sky, alike from everywhere */

static uint8_t srgb(float v) {
  return (uint8_t)(255 * fminf(v <= 0.0031308f ? 12.92f * v : 1.055f * powf(v, 1 / 2.4f) - 0.055f, 1) + 0.5f);
}

static void rotate(const float q[4], const float v[3], float out[3]) { /* v + 2 w (u x v) + 2 u x (u x v) */
  const float *u = q + 1, t[3] = {2 * (u[1] * v[2] - u[2] * v[1]), 2 * (u[2] * v[0] - u[0] * v[2]),
                                  2 * (u[0] * v[1] - u[1] * v[0])};
  for (int i = 0; i < 3; ++i)
    out[i] = v[i] + q[0] * t[i] + u[(i + 1) % 3] * t[(i + 2) % 3] - u[(i + 2) % 3] * t[(i + 1) % 3];
}

/* One buffer of a picture; the caller frees its data. */
static splatbus_image draw(const splatbus_camera* c, uint32_t buffer) {
  const int wide = buffer == SPLATBUS_BUFFER_WORLD_POSITION || buffer == SPLATBUS_BUFFER_NORMAL;
  size_t bytes = (size_t)c->width * c->height * (wide ? 16 : 4);
  splatbus_image image = {buffer, calloc(1, bytes), bytes, SPLATBUS_MEMORY_HOST};
  const float* o = c->world_from_camera.translation;
  for (size_t i = 0; i < (size_t)c->width * c->height; ++i) {
    float ray[3] = {((i % c->width) + 0.5f - c->cx) / c->fx, ((i / c->width) + 0.5f - c->cy) / c->fy, 1}, d[3], n[3];
    rotate(c->world_from_camera.rotation_wxyz, ray, d); /* so that t is the depth along z */
    float a = 0, b = 0, e = -1, cosine = 0;
    for (int k = 0; k < 3; ++k) a += d[k] * d[k], b += d[k] * o[k], e += o[k] * o[k];
    float root = b * b - a * e, t = root < 0 ? -1 : (-b - sqrtf(root)) / a;
    if (t < c->near_m) continue;
    for (int k = 0; k < 3; ++k) n[k] = o[k] + t * d[k], cosine += n[k] * sun[k];
    uint8_t* bytes4 = (uint8_t*)image.data + 4 * i;
    for (int k = 0; k < 3; ++k) {
      float lit = albedo[k] * (irradiance * fmaxf(cosine, 0) / 3.14159265f + sky);
      if (wide) ((float*)image.data)[4 * i + k] = n[k]; /* on this sphere a point is its own normal */
      if (buffer == SPLATBUS_BUFFER_COLOR) bytes4[k] = srgb(lit);
      if (buffer == SPLATBUS_BUFFER_ALBEDO) bytes4[k] = srgb(albedo[k]);
    }
    if (buffer == SPLATBUS_BUFFER_COLOR || buffer == SPLATBUS_BUFFER_ALBEDO) bytes4[3] = 255;
    if (buffer == SPLATBUS_BUFFER_DEPTH) ((float*)image.data)[i] = t;
    if (buffer == SPLATBUS_BUFFER_OBJECT_ID) ((uint32_t*)image.data)[i] = 1; /* static: not listed as an object */
  }
  return image;
}

/* With a rate, every 1 / rate_hz seconds; without, once for each request_id. Role and id together name a camera. */
static int due(const splatbus_camera_request* request, double time_s) {
  static splatbus_camera_request seen[4096];
  static double next_s[4096];
  static size_t count;
  size_t i = 0;
  while (i < count && (seen[i].camera.role != request->camera.role || seen[i].camera.id != request->camera.id)) ++i;
  if (i == sizeof(seen) / sizeof(seen[0])) return 0;
  const int known = i < count && seen[i].request_id == request->request_id;
  if (known && (request->rate_hz == 0 || time_s < next_s[i])) return 0;
  if (i == count) ++count;
  seen[i] = *request;
  next_s[i] = time_s + (request->rate_hz > 0 ? 1 / request->rate_hz : 0);
  return 1;
}

int main(int argc, char** argv) {
  const char *bus = NULL, *name = "engine";
  for (int i = 1; i + 1 < argc; i += 2) *(strcmp(argv[i], "--bus") == 0 ? &bus : &name) = argv[i + 1];
  splatbus_engine* engine = NULL;
  if (splatbus_engine_open(bus, name, SPLATBUS_ENGINE_ABI, SPLATBUS_MEMORY_HOST, &engine) != SPLATBUS_OK)
    return fprintf(stderr, "%s\n", splatbus_engine_last_error(NULL)), 1;
  for (splatbus_frame frame = {.frame = 1};; ++frame.frame) {
    const splatbus_camera_request* requests;
    size_t count;
    int changed;
    if (splatbus_engine_poll(engine, 10, &requests, &count, &changed) != SPLATBUS_OK) break;
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    frame.time_s = (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
    memcpy(frame.light.sun_direction, sun, sizeof(sun));
    for (int k = 0; k < 3; ++k) frame.light.sun_irradiance[k] = irradiance;
    for (int k = 0; k < 3; ++k) frame.light.ambient_sh[9 * k] = sky / 0.2820948f; /* times the constant SH function */
    for (size_t r = 0; r < count; ++r) { /* on a sphere nothing casts a shadow: it has no depth maps for lights */
      if (requests[r].camera.role == SPLATBUS_ROLE_LIGHT || !due(&requests[r], frame.time_s)) continue;
      splatbus_image images[32];
      frame.image_count = 0;
      for (uint32_t bit = 1; bit <= SPLATBUS_BUFFER_OBJECT_ID; bit *= 2)
        if (requests[r].buffers & bit) images[frame.image_count++] = draw(&requests[r].camera, bit);
      frame.images = images, frame.camera = requests[r].camera, frame.request_id = requests[r].request_id;
      if (splatbus_engine_submit(engine, &frame) != SPLATBUS_OK) puts(splatbus_engine_last_error(engine));
      for (size_t i = 0; i < frame.image_count; ++i) free((void*)images[i].data);
    }
  }
  splatbus_engine_close(engine);
}
