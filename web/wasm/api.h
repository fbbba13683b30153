#pragma once

#include <stdint.h>

// What a page calls of splatbus.wasm: the viewer's half of the stream, and the sort. A module with the WASI imports
// that web/src/stream/wasm.ts stubs, and `memory`; call _initialize() first. One thread a module instance. Pointers are
// offsets in its memory, valid until the next call with the same handle; views on the memory die when it grows, which
// any call may make it do. Little endian.
//
// After an allocation that failed a follower starts over with nothing.

#ifdef __EMSCRIPTEN__
#include <emscripten.h>
#define SPLATBUS_EXPORT EMSCRIPTEN_KEEPALIVE
#else
#define SPLATBUS_EXPORT
#endif

#ifdef __cplusplus
namespace splatbus::web {
struct Session;
struct Sorter;
extern "C" {
#else
#error "C++ only"
#endif

/// For what the page hands in. Null when there is no memory.
SPLATBUS_EXPORT void* alloc(uint32_t bytes);
SPLATBUS_EXPORT void release(void* memory);

// The stream. `now_ms`: any steady clock, the same for all calls (performance.now()).

/// `name`, of `name_bytes` in UTF-8, is told to the streamer.
SPLATBUS_EXPORT Session* follower_new(const char* name, uint32_t name_bytes, uint32_t max_gaussians, double now_ms);
SPLATBUS_EXPORT void follower_delete(Session* session);
/// Rate below which the streamer is asked to stay, kbit/s; 0, as it begins: as the streamer likes. It hears of another
/// at once.
SPLATBUS_EXPORT void set_max_kbps(Session* session, uint32_t kbps);
/// The WebSocket is a new one: the next packet that is sent greets.
SPLATBUS_EXPORT void follower_restart(Session* session);

enum ReceiveResult : int32_t {
  kReceived = 0,
  kRefused = 1,      ///< it was wrong, and has changed nothing; error_text() says how
  kOutOfMemory = 2,  ///< all that was held is gone, and asked for anew
};
/// One binary WebSocket message: u32 length of the Packet, Packet, payload.
SPLATBUS_EXPORT int32_t receive(Session* session, const uint8_t* message, uint32_t bytes, double now_ms);
/// Of the last message that was refused, UTF-8.
SPLATBUS_EXPORT const char* error_text(const Session* session);
SPLATBUS_EXPORT uint32_t error_bytes(const Session* session);

/// Bytes of the next message to send, at outgoing_ptr(); 0 when nothing is due. To be called until it is 0, after every
/// receive() and every 50 ms or so while the WebSocket is open.
SPLATBUS_EXPORT uint32_t next_outgoing(Session* session, double now_ms);
SPLATBUS_EXPORT const uint8_t* outgoing_ptr(const Session* session);
/// The last message before the page closes.
SPLATBUS_EXPORT uint32_t farewell(Session* session);

/// Of every picture; it is sent as often as it should. f32: view_from_world [4][4] row-major (x right, y down,
/// z forward; metres), fx, fy, cx, cy, width, height in pixels. False, and nothing is taken, for what is no camera.
SPLATBUS_EXPORT int32_t set_pose(Session* session, const float* pose);

/// Asks the engine for its own picture from there, `pose` as in set_pose(). False, and nothing is asked, for what is no
/// camera. It may never come: who may not probe is not answered.
SPLATBUS_EXPORT int32_t ask_picture(Session* session, double probe_id, const float* pose);
/// Takes the oldest picture that has come; false if there is none. Until the next call: picture_info_ptr() f64[3],
/// probe_id, width, height; picture_ptr() RGBA8 under the sRGB curve, row 0 on top; and where objects were in it,
/// picture_transforms_ptr(), as transforms_ptr().
SPLATBUS_EXPORT int32_t take_picture(Session* session);
SPLATBUS_EXPORT const double* picture_info_ptr(const Session* session);
SPLATBUS_EXPORT const uint8_t* picture_ptr(const Session* session);
SPLATBUS_EXPORT const float* picture_transforms_ptr(const Session* session);

// What is shown. A Gaussian keeps its row as long as it is there. Take records until there are none, or as many a frame
// as the GPU is to be given; then colours; both are of the same picture, and so are transforms and background.

/// Rows that have changed since the last call, `max_rows` at most: changed_rows_ptr() u32[n], ascending (from where the
/// last call ended, then from 0), and changed_records_ptr(), 32 bytes each:
///   0 mean f32[3], object's frame, metres    12 log_scale i16[3], steps of 1/1024
///   18 rotation vector i16[3], steps of pi / 32767, at most half a turn
///   24 u32: opacity u8 (255 is 1), above it the index of its object among the transforms
///   28 colour rgb9e5 (as RGB9_E5): linear and shaded for Transfer; of Radiance degree 0 in display space
/// A row that is free has opacity 0. For Radiance above degree 0 besides changed_harmonics_ptr(),
/// u32[n][harmonic_words()]: [coefficient][RGB] of the whole colour as two half floats a word, the first of them 0.5
/// and the constant band's share. Directions are from the eye to the mean, in the object's frame.
SPLATBUS_EXPORT uint32_t take_changes(Session* session, uint32_t max_rows);
SPLATBUS_EXPORT const uint32_t* changed_rows_ptr(const Session* session);
SPLATBUS_EXPORT const uint8_t* changed_records_ptr(const Session* session);
/// u32[n] of take_changes(): in which row what is in each now was when rows were last taken, 0xFFFFFFFF: in none.
SPLATBUS_EXPORT const uint32_t* changed_origins_ptr(const Session* session);
/// u8[n] of take_changes(): 1 where what was in the row then is in no row now.
SPLATBUS_EXPORT const uint8_t* changed_left_ptr(const Session* session);
/// A multiple of 4; 0: there are no harmonics. It changes only when all rows do.
SPLATBUS_EXPORT uint32_t harmonic_words(const Session* session);
SPLATBUS_EXPORT const uint32_t* changed_harmonics_ptr(const Session* session);
/// The same for rows of which the colour alone has changed, as all have when the sun moves: changed_rows_ptr() and
/// changed_colors_ptr() u32[n] rgb9e5.
SPLATBUS_EXPORT uint32_t take_colors(Session* session, uint32_t max_rows);
SPLATBUS_EXPORT const uint32_t* changed_colors_ptr(const Session* session);
/// All rows are given again: the GPU's memory was lost.
SPLATBUS_EXPORT void forget_taken(Session* session);
/// Rows that were ever used: what a GPU's buffers have to hold.
SPLATBUS_EXPORT uint32_t row_capacity(const Session* session);

/// f32 [transform_count()][3][4], world_from_object, row-major, by the index that records have: 0 is the world. All
/// zero: hidden. To be read after take_changes().
SPLATBUS_EXPORT const float* transforms_ptr(Session* session);
SPLATBUS_EXPORT uint32_t transform_count(Session* session);
/// Index of the far field, 0: there is none. It goes with the eye: to its transform's last column the eye's position is
/// to be added.
SPLATBUS_EXPORT uint32_t far_field_index(const Session* session);
/// Index of the camera of the engine's player, whose transform is world_from_camera (x right, y down, z forward); 0:
/// there is none.
SPLATBUS_EXPORT uint32_t player_index(Session* session);
/// f32[3], linear.
SPLATBUS_EXPORT const float* background_ptr(Session* session);
SPLATBUS_EXPORT double scene_version(const Session* session);

/// f64 each, in this order.
enum Stat : uint32_t {
  kStatGaussians,
  kStatRowsWaiting,  ///< for take_changes()
  kStatConnected,    ///< 1 after the streamer's welcome
  kStatPages,        ///< that the streamer has for this viewer
  kStatMissingPages,
  kStatSequence,  ///< newest packet of the connection
  kStatEpoch,
  kStatBytesIn,
  kStatRefused,
  kStatLost,    ///< packets that did not come
  kStatLacked,  ///< pages that were asked for again
  kStatSceneVersion,
  kStatSceneFrame,
  kStatSceneCaptureMs,  ///< of the engine's clock; 0: unknown
  kStatSceneArrivedMs,  ///< of the page's clock
  kStatRadiance,        ///< 1: colours are in display space and are blended there
  kStatColorsMs,        ///< the instant of the scene that the colours last taken show, as kStatSceneCaptureMs
  kStats
};
SPLATBUS_EXPORT const double* stats_ptr(Session* session);
/// Of all integers that are held after the last packet, as two u32, lowest first: for tests.
SPLATBUS_EXPORT const uint32_t* held_hash_ptr(Session* session);

// The sort, of another module instance in another worker.

SPLATBUS_EXPORT Sorter* sorter_new();
SPLATBUS_EXPORT void sorter_delete(Sorter* sorter);
/// Rows as row_capacity() says; those that are new are hidden.
SPLATBUS_EXPORT void sorter_rows(Sorter* sorter, uint32_t rows);
/// What take_changes() gave: u32[n], and n records of 32 bytes. 0, or 1 where a row is not below sorter_rows().
SPLATBUS_EXPORT int32_t sorter_update(Sorter* sorter, const uint32_t* rows, const uint8_t* records, uint32_t n);
/// f32 [n][3][4] as transforms_ptr(), and far_field_index().
SPLATBUS_EXPORT void sorter_transforms(Sorter* sorter, const float* transforms, uint32_t n, uint32_t far_field);
/// Number of rows before the camera, farthest first at order_ptr(), u32[n]. view_from_world as in set_pose().
SPLATBUS_EXPORT uint32_t sort(Sorter* sorter, const float* view_from_world);
SPLATBUS_EXPORT const uint32_t* order_ptr(const Sorter* sorter);

}  // extern "C"
}  // namespace splatbus::web
