/* splatbus engine SDK: a C ABI that any engine links to take part in the bus.
 *
 * Conventions at this boundary: world right-handed, metres, y up; cameras x right, y down, z forward, pixel centres at
 * +0.5; quaternions w x y z; images row-major with row 0 on top; light linear. An engine that differs converts before
 * it calls.
 *
 * Threads: one handle, one thread at a time, of which none is ever kept waiting for the bus: there need not be one yet,
 * and it may go and come back. Ownership: pointers passed in are read during the call only; pointers
 * passed out stay good until the next call of the same function on that handle. Errors: functions return SPLATBUS_OK or
 * a negative code, and splatbus_engine_last_error() has the words. A call that fails changes nothing: submit the next
 * frame. */
#ifndef SPLATBUS_ENGINE_H
#define SPLATBUS_ENGINE_H

#include <stddef.h>
#include <stdint.h>

/* NOLINTBEGIN(modernize-use-using): C */
#ifdef __cplusplus
extern "C" {
#endif

#define SPLATBUS_ENGINE_ABI 3
#define SPLATBUS_MAX_OBJECTS 32768       /* of one frame */
#define SPLATBUS_RESERVED_ID 0xFA00FA00U /* of no object: that of what lies beyond all objects */
#define SPLATBUS_PLAYER_ID 0xFA00FA01U   /* of an object without surfaces: a player's camera */
#define SPLATBUS_MAX_LIGHTS 32           /* of one frame, besides the sun */

typedef enum { SPLATBUS_OK = 0, SPLATBUS_ERROR_ARGUMENT = -1, SPLATBUS_ERROR_BUS = -2 } splatbus_status;

typedef enum {
  SPLATBUS_BUFFER_COLOR = 1,          /* u8 RGBA, linear light under the sRGB curve, anti-aliased, over the background;
                                         alpha is coverage by surfaces */
  SPLATBUS_BUFFER_WORLD_POSITION = 2, /* f32 x 4: metres; w counts for nothing */
  SPLATBUS_BUFFER_NORMAL = 4,         /* f32 x 4: unit, world */
  SPLATBUS_BUFFER_ALBEDO = 8,         /* u8 RGBA, diffuse albedo, as colour but over black: alpha is in it */
  SPLATBUS_BUFFER_DEPTH = 16,         /* f32: metres along the camera's z, 0 where there is no surface */
  SPLATBUS_BUFFER_LIGHT_DEPTH = 32,   /* f32: role light; metres along z, far_m where there is no surface */
  SPLATBUS_BUFFER_OBJECT_ID = 64      /* u32 (an R32UI target, say), 0 where there is no surface; of pixels of
                                         SPLATBUS_RESERVED_ID no Gaussians are made. What is not to be learned either is
                                         an object with SPLATBUS_OBJECT_NOT_MODELLED */
} splatbus_buffer;

/* A camera is known by its role and its id together: an input camera 3 and a reference camera 3 are two. */
typedef enum { SPLATBUS_ROLE_INPUT, SPLATBUS_ROLE_REFERENCE, SPLATBUS_ROLE_PROBE, SPLATBUS_ROLE_LIGHT } splatbus_role;

/* Where bytes lie: CUDA is the memory of this process's first CUDA device. */
typedef enum { SPLATBUS_MEMORY_HOST = 0, SPLATBUS_MEMORY_CUDA = 1 } splatbus_memory;

/* a_from_b: p_a = rotation * p_b + translation; the quaternion is unit. */
typedef struct {
  float rotation_wxyz[4];
  float translation[3];
} splatbus_rigid;

/* Pinhole, in pixels; role light, of the sun and directional lights: orthographic, fx and fy in pixels a metre. */
typedef struct {
  uint32_t id;   /* unique among the cameras of its role */
  uint32_t role; /* splatbus_role */
  uint32_t width, height;
  float fx, fy, cx, cy;
  float near_m, far_m;
  splatbus_rigid world_from_camera;
} splatbus_camera;

/* For role light only id, size, the translation of world_from_camera and the last three fields count: the engine sets
 * pose, fx, fy, near and far, and submits a map anew whenever it would show anything else. All maps of one
 * depth_version have been submitted before a picture is that shows it.
 *
 * The sun (light_id 0) and directional lights have cascades, orthographic, that look along the light: one over a square
 * with sides of extent_m around world_from_camera.translation, or over the whole scene where extent_m is 0; near and
 * far take in everything that casts a shadow there. Its pose moves by whole texels, so that a rest of the light is a
 * rest of its shadows. A point light has the maps 0 to 5, pinhole pictures that together see everything around it, a
 * spot light the map 0, a pinhole picture of its cone. */
typedef struct {
  splatbus_camera camera;
  uint32_t buffers; /* bits of splatbus_buffer */
  float rate_hz;    /* of engine time; 0: once for each new request_id */
  uint64_t request_id;
  uint32_t light_id; /* of splatbus_light_source; 0: the sun */
  uint32_t light_map;
  float extent_m; /* of a cascade */
} splatbus_camera_request;

typedef enum {
  SPLATBUS_OBJECT_EMISSIVE = 1,    /* its surfaces shine with what the picture ALBEDO shows of them, and are not lit */
  SPLATBUS_OBJECT_NOT_MODELLED = 2 /* no Gaussians are made of it, and nothing is learned where it shows: what is drawn
                                      otherwise, a weapon in the hand, say */
} splatbus_object_flags;

/* What can move, come or go is an object: it has an id, any but 0, that its surfaces have in the picture OBJECT_ID, and
 * a rigid frame. An object exists in the frames that list it. One that is no longer listed is hidden, keeps what was
 * learned of it, and is whole again when it returns under its id.
 *
 * Static geometry needs no object and is not listed. Its surfaces have any id that is never listed: 1 for all of it
 * will do. Not 0, which says that there is no surface, and not SPLATBUS_RESERVED_ID. An engine whose ids name every
 * mesh may leave those of what stands still as they are.
 *
 * Characters: each bone of a skinned mesh is an object with an id of its own, whose frame is the bone's rigid one. A
 * surface has the id of the bone that has the greatest weight there, the dominant bone, so write ids by vertex weights,
 * not by mesh. Where several bones share the weight, the surface bends a little against its frame; shear of a bone has
 * no place in it. An id stays with its bone for as long as the character lives.
 *
 * A player: an engine may list an object SPLATBUS_PLAYER_ID, whose frame is that of the camera of whoever plays (x
 * right, y down, z forward). Viewers offer to go along with it. It has no surfaces.
 *
 * p_world = world_from_object.rotation * (scale * p_object) + world_from_object.translation. */
typedef struct {
  uint32_t id;
  splatbus_rigid world_from_object;
  float scale;    /* above 0, the same along all axes; 1 for most */
  uint32_t flags; /* bits of splatbus_object_flags */
} splatbus_object;

typedef enum { SPLATBUS_LIGHT_DIRECTIONAL, SPLATBUS_LIGHT_POINT, SPLATBUS_LIGHT_SPOT } splatbus_light_kind;

/* A light besides the sun. Irradiance on a surface that faces it: of a directional light `intensity`; of the others, at
 * d metres, intensity * clamp(1 - (d / range_m)^4, 0, 1)^2 / max(d, 0.01)^2 (Karis 2013), a spot's times
 * clamp((cos - cos_outer) / (cos_inner - cos_outer), 0, 1)^2, cos of the angle from its axis (glTF,
 * KHR_lights_punctual). */
typedef struct {
  uint32_t id; /* not 0; stays with the light for as long as it exists */
  uint32_t kind;
  uint32_t casts_shadow;      /* 0: it shines through everything, and has no depth maps */
  float position[3];          /* point, spot: metres */
  float direction[3];         /* unit; directional: towards the light; spot: its axis, away from it */
  float intensity[3];         /* linear, not below 0 */
  float range_m;              /* point, spot: above 0 */
  float cos_inner, cos_outer; /* spot: -1 <= outer < inner <= 1 */
  /* Another one whenever its depth maps would show anything else; 0: with every change of the scene, which is right and
   * costs more. */
  uint64_t depth_version;
} splatbus_light_source;

/* What lit the picture COLOR, all of it. Two things follow from it. Appearance is learned as albedo and a residual, so
 * that a model can be shown under a light that it was not trained with: what the engine shades by is said here, or the
 * light of this moment is learned as paint. And depth maps of role LIGHT are asked for by it. Shading is expected to be
 * Lambert's, albedo / pi * irradiance * visibility, summed over the sun and the sources, and the ambient light's
 * irradiance; what differs (gloss, bounces) is learned as the residual. An engine that knows none of this leaves
 * everything 0 but sun_direction, and the trainer and the expander get the parameter appearance=radiance: the model has
 * then the colours as they are seen. */
typedef struct {
  float ambient_sh[27];    /* incident radiance: 9 real SH coefficients for R, 9 for G, 9 for B, signs as in 3DGS; the
                              first of each channel is not below 0 */
  float sun_direction[3];  /* unit, towards the sun */
  float sun_irradiance[3]; /* on a surface that faces the sun, not below 0 */
  float background[3];     /* linear colour behind everything, not below 0 */
  const splatbus_light_source* sources; /* besides the sun; ids are unique */
  size_t source_count;                  /* at most SPLATBUS_MAX_LIGHTS */
  uint64_t sun_depth_version;           /* as a source's depth_version */
} splatbus_light;

typedef struct {
  uint32_t buffer; /* one splatbus_buffer */
  const void* data;
  size_t bytes;    /* exactly width * height * element size; in CUDA memory they must all be there, which is checked */
  uint32_t memory; /* splatbus_memory: where `data` points, a device address for CUDA */
} splatbus_image;

typedef struct {
  /* Grows from one instant of the engine to the next, by 1 or by more, and is the same for all cameras of one instant.
   * One that is less than the last is refused, on one handle; objects and light are those of the first camera of it. */
  uint64_t frame;
  double time_s;       /* engine time, never less either: an engine whose clock starts anew opens another handle */
  uint64_t request_id; /* of the request */
  splatbus_camera camera;
  uint32_t light_id, light_map; /* role light: of the request */
  const splatbus_image* images; /* none, where nothing is to be rendered: it says objects and light alone, and
                                   request_id, camera and what is of it do not count */
  size_t image_count;
  const splatbus_object* objects; /* every one that exists now; ids are unique */
  size_t object_count;            /* at most SPLATBUS_MAX_OBJECTS */
  splatbus_light light;
} splatbus_frame;

typedef struct splatbus_engine splatbus_engine;

/* Joins the bus at `address` (NULL: SPLATBUS_BUS or the default) under the name `source`, unique on the bus. `abi` is
 * SPLATBUS_ENGINE_ABI. `memory`, of splatbus_memory, is where readers find the frames, wherever the engine has them:
 * choose the side on which most images are. CUDA where this library or this machine has none is an argument error. The
 * broker need not be there yet. *out is NULL when it fails, and not written for an `abi` that is another. */
splatbus_status splatbus_engine_open(const char* address, const char* source, uint32_t abi, uint32_t memory,
                                     splatbus_engine** out);

/* Leaves the bus; gives the broker up to a second, or where it hangs three, to take what was submitted. NULL is
 * allowed. */
void splatbus_engine_close(splatbus_engine* engine);

/* Takes in camera requests that have arrived, waiting up to timeout_ms for a change. The whole set as it now stands is
 * at *requests; *changed is 1 when it is another than before. Requests that make no sense are left out and logged.
 *
 * Several engines of one world share the requests: each gets its part, and another one when engines come or go. Of one
 * that does not lead only those frames count whose objects (but for SPLATBUS_PLAYER_ID) and light equal, bit for bit,
 * those of a frame of the one that leads: all of them show the instants of one clock (the ticks of the simulation that
 * they share, not what each interpolates for its own player), and no state of theirs alone. Frame numbers, times and
 * depth versions may differ. */
splatbus_status splatbus_engine_poll(splatbus_engine* engine, int timeout_ms, const splatbus_camera_request** requests,
                                     size_t* count, int* changed);

/* Publishes one camera of one frame, or where objects or light have changed and no camera is due, the frame alone:
 * viewers see what moves at the rate at which it is said. Copies the images into a slab ring in which readers have
 * about a second. Waits for nobody: frames of a size that is new are published by a thread of this library as soon as
 * the broker has their memory, and where there is no broker the newest wait for it, half a ring of them (4 large ones,
 * 64 small ones); the others are dropped and counted. SPLATBUS_ERROR_BUS: the bus refused the memory of frames before
 * this one, because another process publishes under this name, say; or there is no memory, or the device failed. Checks
 * everything but the pixels: transforms, ids, light, camera, sizes, and that frame and time do not run backwards. What
 * is wrong is refused with SPLATBUS_ERROR_ARGUMENT and words that name it, and nothing of the call is published.
 *
 * An image in CUDA memory is complete before the call: its writer has waited for its stream, or for the graphics API
 * that it is shared with. The copy runs on a stream of the calling thread's own, from device to device when the frames
 * lie there, and has ended when the call returns: the image may be written again at once. */
splatbus_status splatbus_engine_submit(splatbus_engine* engine, const splatbus_frame* frame);

/* As splatbus_engine_submit() for each of `count` cameras in turn, of one frame or of several; but copies on a device
 * are waited for together, those of as many as half a ring holds (4 large frames, 64 small ones). Others use the device
 * meanwhile, and each wait is as long as their turn. Where an argument is refused nothing of the call is published;
 * where the bus has no memory, or the device fails, what came before that may be. */
splatbus_status splatbus_engine_submit_all(splatbus_engine* engine, const splatbus_frame* frames, size_t count);

/* Shown in heartbeats, which are sent 5 times a second. */
splatbus_status splatbus_engine_counter(splatbus_engine* engine, const char* name, double value);

/* Frames that were submitted and could not be published. Also a counter of the heartbeats, frames_dropped. */
uint64_t splatbus_engine_frames_dropped(const splatbus_engine* engine);

/* The words for the last call that failed on this handle; for NULL, for this thread's last splatbus_engine_open(). */
const char* splatbus_engine_last_error(const splatbus_engine* engine);

#ifdef __cplusplus
}
#endif
/* NOLINTEND(modernize-use-using) */
#endif
