#include "api.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <memory>
#include <new>
#include <optional>
#include <string>
#include <vector>

#include "gaussians/depth_order.h"
#include "stream/bytes.h"
#include "stream/color_times.h"
#include "stream/follower.h"
#include "stream/gpu_rows.h"
#include "stream/held_hash.h"
#include "wire/convert.h"
#include "wire/picture_size.h"

namespace splatbus::web {

namespace {

constexpr double kNsAMs = 1e6;
constexpr std::size_t kLengthBytes = 4;
constexpr float kRotationTolerance = 0.01F;
constexpr std::size_t kHeldPictureBytes = std::size_t{1} << 25;

std::int64_t ns_of(double now_ms) {
  return static_cast<std::int64_t>(now_ms * kNsAMs);
}

/// Of a wall of screens; what is told of it has kMaxPictureSide at most.
constexpr std::uint32_t kMaxWindowSide = 1U << 16U;

/// view_from_world, fx, fy, cx, cy, width, height.
std::optional<Camera> camera_of(const float* pose, std::uint32_t max_side) {
  if (!std::all_of(pose, pose + 22, [](float value) { return std::isfinite(value); })) return std::nullopt;
  glm::mat3 view;  // columns by rows
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) view[column][row] = pose[4 * row + column];
  }
  const glm::mat3 world = glm::transpose(view), error = world * view - glm::mat3(1);
  for (int k = 0; k < 3; ++k) {
    if (!(glm::length(error[k]) < kRotationTolerance)) return std::nullopt;
  }
  if (!(glm::determinant(view) > 0)) return std::nullopt;
  const auto side = [&](int k) { return pose[k] >= 1 && pose[k] <= static_cast<float>(max_side); };
  if (!side(20) || !side(21) || !(pose[16] > 0) || !(pose[17] > 0)) return std::nullopt;
  Camera camera;
  camera.fx = pose[16], camera.fy = pose[17], camera.cx = pose[18], camera.cy = pose[19];
  camera.width = static_cast<std::uint32_t>(pose[20]), camera.height = static_cast<std::uint32_t>(pose[21]);
  camera.world_from_camera.rotation = glm::normalize(glm::quat_cast(world));
  camera.world_from_camera.translation = -(world * glm::vec3(pose[3], pose[7], pose[11]));
  return camera;
}

/// What is lost when there is no memory.
struct Held {
  stream::Follower follower;
  stream::GpuRows rows;
  stream::ColorTimes color_times;
  std::int64_t colors_ns = 0;

  Held(const stream::FollowerOptions& options, std::int64_t now_ns)
      : follower(options, now_ns), rows(follower.replica()) {}
};

}  // namespace

struct Session {
  stream::FollowerOptions options;
  std::optional<Held> held;
  std::string error;
  stream::Bytes outgoing;
  std::vector<std::uint32_t> changed_rows, changed_colors, changed_harmonics;
  std::vector<stream::GpuRecord> changed_records;
  stream::GpuRows::Turnover changed_turnover;
  std::array<float, 3> background{};
  std::array<double, kStats> stats{};
  std::array<std::uint32_t, 2> hash{};
  double scene_arrived_ms = 0;
  stream::ProbeAnswer picture;
  std::array<double, 3> picture_info{};
  std::vector<stream::GpuRows::Transform> picture_transforms;

  void put(const stream::EncodedPacket& packet) {
    const auto length = static_cast<std::uint32_t>(packet.packet.size());
    outgoing.resize(kLengthBytes);
    std::memcpy(outgoing.data(), &length, kLengthBytes);
    outgoing.insert(outgoing.end(), packet.packet.begin(), packet.packet.end());
    outgoing.insert(outgoing.end(), packet.payload.begin(), packet.payload.end());
  }
};

struct Sorter {
  DepthOrder order;
  std::vector<DepthOrder::Transform> transforms;
  std::span<const std::uint32_t> sorted;
};

extern "C" {

void* alloc(uint32_t bytes) {
  return std::malloc(std::max(bytes, 1U));
}

void release(void* memory) {
  std::free(memory);
}

Session* follower_new(const char* name, uint32_t name_bytes, uint32_t max_gaussians, double now_ms) {
  auto session = std::make_unique<Session>();
  session->options.name.assign(name, name_bytes);
  session->options.own_probes = true;
  session->options.held_picture_bytes = kHeldPictureBytes;
  session->options.max_gaussians = std::min<std::size_t>(max_gaussians, stream::kMaxGaussians);
  session->held.emplace(session->options, ns_of(now_ms));
  return session.release();
}

void follower_delete(Session* session) {
  delete session;
}

void set_max_kbps(Session* session, uint32_t kbps) {
  session->options.max_kbps = kbps;  // of those to come, after an allocation that failed
  session->held->follower.set_max_kbps(kbps);
}

void follower_restart(Session* session) {
  session->held->follower.restart();
}

int32_t receive(Session* session, const uint8_t* message, uint32_t bytes, double now_ms) {
  stream::Follower& follower = session->held->follower;
  try {
    std::uint32_t length = 0;
    if (bytes < kLengthBytes) throw stream::StreamError("message: no length");
    std::memcpy(&length, message, kLengthBytes);
    if (length > bytes - kLengthBytes) throw stream::StreamError("message: shorter than its packet");
    const std::span<const std::uint8_t> rest(message + kLengthBytes, bytes - kLengthBytes);
    const stream::SceneInstant before = follower.replica().scene_instant();
    follower.receive(rest.first(length), rest.subspan(length), ns_of(now_ms));
    session->held->color_times.see(follower.replica());
    if (follower.replica().scene_instant() != before) session->scene_arrived_ms = now_ms;
    return kReceived;
  } catch (const std::bad_alloc&) {
    session->held.emplace(session->options, ns_of(now_ms));
    session->error = "out of memory";
    return kOutOfMemory;
  } catch (const std::exception& error) {
    session->error = error.what();
    return kRefused;
  }
}

const char* error_text(const Session* session) {
  return session->error.data();
}

uint32_t error_bytes(const Session* session) {
  return static_cast<std::uint32_t>(session->error.size());
}

uint32_t next_outgoing(Session* session, double now_ms) {
  const auto packet = session->held->follower.next_outgoing(ns_of(now_ms));
  if (!packet) return 0;
  session->put(*packet);
  return static_cast<std::uint32_t>(session->outgoing.size());
}

const uint8_t* outgoing_ptr(const Session* session) {
  return session->outgoing.data();
}

uint32_t farewell(Session* session) {
  session->put(session->held->follower.farewell());
  return static_cast<std::uint32_t>(session->outgoing.size());
}

int32_t set_pose(Session* session, const float* pose) {
  const auto camera = camera_of(pose, kMaxWindowSide);
  if (!camera) return 0;
  session->held->follower.set_camera(*camera);
  return 1;
}

int32_t ask_picture(Session* session, double probe_id, const float* pose) {
  const auto camera = camera_of(pose, kMaxPictureSide);
  if (!camera) return 0;
  session->held->follower.say(wire::Body::Probe, [&](auto& builder) {
    const wire::Camera wired = to_wire(*camera);
    return wire::CreateProbe(builder, static_cast<std::uint64_t>(probe_id), &wired);
  });
  return 1;
}

int32_t take_picture(Session* session) {
  auto answer = session->held->follower.take_probe_answer();
  if (!answer) return 0;
  session->picture = std::move(*answer);
  const stream::ProbeAnswer& picture = session->picture;
  session->picture_info = {static_cast<double>(picture.probe_id), static_cast<double>(picture.camera.width),
                           static_cast<double>(picture.camera.height)};
  session->picture_transforms = session->held->rows.transforms_in(picture.scene);
  return 1;
}

const double* picture_info_ptr(const Session* session) {
  return session->picture_info.data();
}

const uint8_t* picture_ptr(const Session* session) {
  return session->picture.rgba.data();
}

const float* picture_transforms_ptr(const Session* session) {
  return session->picture_transforms.data()->data();
}

uint32_t take_changes(Session* session, uint32_t max_rows) {
  session->held->rows.take_records(max_rows, session->changed_rows, session->changed_records,
                                   &session->changed_harmonics, &session->changed_turnover);
  return static_cast<std::uint32_t>(session->changed_rows.size());
}

const uint32_t* changed_rows_ptr(const Session* session) {
  return session->changed_rows.data();
}

const uint8_t* changed_records_ptr(const Session* session) {
  return reinterpret_cast<const std::uint8_t*>(session->changed_records.data());
}

const uint32_t* changed_origins_ptr(const Session* session) {
  return session->changed_turnover.origins.data();
}

const uint8_t* changed_left_ptr(const Session* session) {
  return session->changed_turnover.left.data();
}

uint32_t harmonic_words(const Session* session) {
  return static_cast<std::uint32_t>(stream::harmonic_words(session->held->follower.replica().shown().layout));
}

const uint32_t* changed_harmonics_ptr(const Session* session) {
  return session->changed_harmonics.data();
}

uint32_t take_colors(Session* session, uint32_t max_rows) {
  Held& held = *session->held;
  held.rows.take_colors(max_rows, session->changed_rows, session->changed_colors);
  held.colors_ns = held.color_times.taken(held.follower.replica(), session->changed_rows.size() == max_rows);
  return static_cast<std::uint32_t>(session->changed_rows.size());
}

const uint32_t* changed_colors_ptr(const Session* session) {
  return session->changed_colors.data();
}

void forget_taken(Session* session) {
  session->held->rows.forget_taken();
}

uint32_t row_capacity(const Session* session) {
  return static_cast<std::uint32_t>(session->held->rows.capacity());
}

const float* transforms_ptr(Session* session) {
  return session->held->rows.transforms().data()->data();
}

uint32_t transform_count(Session* session) {
  return static_cast<std::uint32_t>(session->held->rows.transforms().size());
}

uint32_t far_field_index(const Session* session) {
  return session->held->rows.far_field();
}

uint32_t player_index(Session* session) {
  static_cast<void>(session->held->rows.transforms());
  return session->held->rows.player();
}

const float* background_ptr(Session* session) {
  const glm::vec3& color = session->held->follower.replica().scene().light.background;
  session->background = {color.x, color.y, color.z};
  return session->background.data();
}

double scene_version(const Session* session) {
  return static_cast<double>(session->held->follower.replica().scene_version());
}

const double* stats_ptr(Session* session) {
  const stream::Follower& follower = session->held->follower;
  const stream::Replica& replica = follower.replica();
  const auto number = [](auto value) { return static_cast<double>(value); };
  session->stats = {number(replica.count()),
                    number(session->held->rows.unsent()),
                    number(follower.connected()),
                    number(replica.pages()),
                    number(replica.missing_pages()),
                    number(replica.report().newest),
                    number(replica.epoch()),
                    number(follower.received_bytes()),
                    number(follower.refused()),
                    number(follower.lost()),
                    number(follower.lacked()),
                    number(replica.scene_version()),
                    number(replica.scene_instant().frame),
                    number(replica.scene_instant().capture_ns) / kNsAMs,
                    session->scene_arrived_ms,
                    number(replica.layout().appearance == Appearance::Radiance),
                    number(session->held->colors_ns) / kNsAMs};
  return session->stats.data();
}

const uint32_t* held_hash_ptr(Session* session) {
  const std::uint64_t hash = stream::held_hash(session->held->follower.replica().held());
  session->hash = {static_cast<std::uint32_t>(hash), static_cast<std::uint32_t>(hash >> 32)};
  return session->hash.data();
}

Sorter* sorter_new() {
  return new Sorter;
}

void sorter_delete(Sorter* sorter) {
  delete sorter;
}

void sorter_rows(Sorter* sorter, uint32_t rows) {
  sorter->order.resize(rows);
}

int32_t sorter_update(Sorter* sorter, const uint32_t* rows, const uint8_t* records, uint32_t n) {
  for (std::uint32_t k = 0; k < n; ++k) {
    if (rows[k] >= sorter->order.rows()) return 1;
    stream::GpuRecord record;
    std::memcpy(&record, records + k * sizeof(record), sizeof(record));
    if ((record.opacity_object & 0xFFU) == 0) {
      sorter->order.hide(rows[k]);
    } else {
      sorter->order.place(rows[k], {record.mean[0], record.mean[1], record.mean[2]}, record.opacity_object >> 8);
    }
  }
  return 0;
}

void sorter_transforms(Sorter* sorter, const float* transforms, uint32_t n, uint32_t far_field) {
  sorter->transforms.resize(n);
  std::memcpy(sorter->transforms.data(), transforms, n * sizeof(DepthOrder::Transform));
  sorter->order.set_transforms(sorter->transforms, far_field);
}

uint32_t sort(Sorter* sorter, const float* view_from_world) {
  sorter->sorted =
      sorter->order.sort({view_from_world[8], view_from_world[9], view_from_world[10], view_from_world[11]});
  return static_cast<std::uint32_t>(sorter->sorted.size());
}

const uint32_t* order_ptr(const Sorter* sorter) {
  return sorter->sorted.data();
}

}  // extern "C"

}  // namespace splatbus::web
