/* splatbus engine SDK: a C ABI that any engine links to take part in the bus.
 *
 * Conventions at this boundary: world right-handed, metres, y up; cameras x right, y down, z forward; quaternions w x y z;
 * images row-major with row 0 on top; light linear. An engine that differs converts before it calls.
 *
 * Threads: one handle, one thread at a time. Ownership: pointers passed in are read during the call only; pointers passed out stay good
 * until the next splatbus_engine_poll() on that handle. Errors: functions return SPLATBUS_OK or a negative code, and
 * splatbus_engine_last_error() has the words. */
#ifndef SPLATBUS_ENGINE_H
#define SPLATBUS_ENGINE_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define SPLATBUS_ENGINE_ABI 1

typedef enum { SPLATBUS_OK = 0, SPLATBUS_ERROR_ARGUMENT = -1, SPLATBUS_ERROR_BUS = -2 } splatbus_status;

typedef enum {
  SPLATBUS_BUFFER_COLOR = 1,          /* u8 RGBA, linear light under the sRGB curve, anti-aliased */
  SPLATBUS_BUFFER_WORLD_POSITION = 2, /* f32 x 4: metres; w = object id, 0 where there is no surface */
  SPLATBUS_BUFFER_NORMAL = 4,         /* f32 x 4: unit, world */
  SPLATBUS_BUFFER_ALBEDO = 8,         /* u8 RGBA, as colour */
  SPLATBUS_BUFFER_DEPTH = 16,         /* f32: metres along the camera's z, 0 where there is no surface */
  SPLATBUS_BUFFER_LIGHT_DEPTH = 32    /* f32: role light; metres along z, far_m where there is no surface */
} splatbus_buffer;

typedef enum { SPLATBUS_ROLE_INPUT, SPLATBUS_ROLE_REFERENCE, SPLATBUS_ROLE_PROBE, SPLATBUS_ROLE_LIGHT } splatbus_role;

typedef struct { float rotation_wxyz[4]; float translation[3]; } splatbus_rigid;

typedef struct {
  uint32_t id;
  uint32_t role; /* splatbus_role */
  uint32_t width, height;
  float fx, fy, cx, cy;
  float near_m, far_m;
  splatbus_rigid world_from_camera;
} splatbus_camera;

typedef struct {
  splatbus_camera camera;
  uint32_t buffers;    /* bits of splatbus_buffer */
  float rate_hz;       /* of engine time; 0: once for each new request_id */
  uint64_t request_id;
} splatbus_camera_request;

typedef struct { uint32_t id; splatbus_rigid world_from_object; } splatbus_object;

typedef struct {
  float ambient_sh[27];     /* incident radiance: 9 coefficients R, 9 G, 9 B */
  float sun_direction[3];   /* unit, towards the sun */
  float sun_irradiance[3];
  float background[3];
} splatbus_light;

typedef struct {
  uint32_t buffer; /* one splatbus_buffer */
  const void* data;
  size_t bytes;    /* exactly width * height * element size */
} splatbus_image;

typedef struct {
  uint64_t frame;
  double time_s;
  uint64_t request_id;
  splatbus_camera camera;
  const splatbus_image* images;
  size_t image_count;
  const splatbus_object* objects;
  size_t object_count;
  splatbus_light light;
} splatbus_frame;

typedef struct splatbus_engine splatbus_engine;

/* Joins the bus at `address` (NULL: SPLATBUS_BUS or the default) under `source`. abi is SPLATBUS_ENGINE_ABI. */
splatbus_status splatbus_engine_open(const char* address, const char* source, uint32_t abi, splatbus_engine** out);
void splatbus_engine_close(splatbus_engine* engine);

/* Takes in camera requests that have arrived, waiting up to timeout_ms for a change. *changed is 1 when the set is another. */
splatbus_status splatbus_engine_poll(splatbus_engine* engine, int timeout_ms, const splatbus_camera_request** requests,
                                     size_t* count, int* changed);

/* Publishes one camera of one frame. Copies the images into a slab ring. */
splatbus_status splatbus_engine_submit(splatbus_engine* engine, const splatbus_frame* frame);

/* Shown in heartbeats. */
splatbus_status splatbus_engine_counter(splatbus_engine* engine, const char* name, double value);

const char* splatbus_engine_last_error(const splatbus_engine* engine);

#ifdef __cplusplus
}
#endif
#endif
