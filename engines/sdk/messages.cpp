#include "sdk/messages.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <bit>
#include <cstring>
#include <span>
#include <utility>

#include "bus/frames.h"
#include "sdk/validate.h"
#include "wire/camera_struct.h"

namespace splatbus::engine_sdk {
namespace {

constexpr std::size_t kMaxCameras = 4096;

splatbus_rigid from_wire(const wire::Rigid& rigid) {
  const wire::Quat& q = rigid.rotation();
  const wire::Vec3& t = rigid.translation();
  return {{q.w(), q.x(), q.y(), q.z()}, {t.x(), t.y(), t.z()}};
}

wire::Rigid to_wire(const splatbus_rigid& rigid) {
  const float* q = rigid.rotation_wxyz;
  const float* t = rigid.translation;
  return {wire::Quat(q[0], q[1], q[2], q[3]), wire::Vec3(t[0], t[1], t[2])};
}

wire::Vec3 to_wire(const float (&v)[3]) {
  return {v[0], v[1], v[2]};
}

wire::Camera to_wire(const splatbus_camera& camera) {
  return camera_struct(camera, to_wire(camera.world_from_camera));
}

/// With zero for what does not count for its kind, which may be anything.
splatbus_light_source counted(splatbus_light_source source) {
  const bool directional = source.kind == SPLATBUS_LIGHT_DIRECTIONAL;
  if (directional) std::ranges::fill(source.position, 0.0F);
  if (directional) source.range_m = 0;
  if (source.kind == SPLATBUS_LIGHT_POINT) std::ranges::fill(source.direction, 0.0F);
  if (source.kind != SPLATBUS_LIGHT_SPOT) source.cos_inner = source.cos_outer = 0;
  source.casts_shadow = source.casts_shadow != 0 ? 1 : 0;
  return source;
}

/// By ascending id.
std::vector<splatbus_light_source> sources_of(const splatbus_light& light) {
  std::vector<splatbus_light_source> sources;
  for (const splatbus_light_source& source : std::span(light.sources, light.source_count)) {
    sources.push_back(counted(source));
  }
  std::ranges::sort(sources, {}, &splatbus_light_source::id);
  return sources;
}

/// Fowler, Noll and Vo's FNV-1a over the light's floats.
std::uint64_t light_hash(const splatbus_light& light, const std::vector<splatbus_light_source>& sources) {
  std::uint64_t hash = 14695981039346656037ULL;
  const auto mix = [&](std::span<const float> values) {
    for (const float value : values) {
      std::uint32_t bits = 0;
      std::memcpy(&bits, &value, sizeof(bits));
      for (unsigned shift = 0; shift < 32; shift += 8) hash = (hash ^ ((bits >> shift) & 0xFFU)) * 1099511628211ULL;
    }
  };
  mix(light.ambient_sh);
  mix(light.sun_direction);
  mix(light.sun_irradiance);
  mix(light.background);
  for (const splatbus_light_source& source : sources) {
    mix(source.position);
    mix(source.direction);
    mix(source.intensity);
    mix({{source.range_m, source.cos_inner, source.cos_outer}});
    mix({{std::bit_cast<float>(source.id), std::bit_cast<float>(source.kind),
          std::bit_cast<float>(source.casts_shadow)}});
  }
  return hash;
}

std::vector<wire::LightSource> to_wire(const std::vector<splatbus_light_source>& sources) {
  std::vector<wire::LightSource> structs;
  structs.reserve(sources.size());
  for (const splatbus_light_source& source : sources) {
    structs.emplace_back(source.id, static_cast<wire::LightKind>(source.kind), source.casts_shadow != 0,
                         to_wire(source.position), to_wire(source.direction), to_wire(source.intensity), source.range_m,
                         source.cos_inner, source.cos_outer, source.depth_version);
  }
  return structs;
}

}  // namespace

bool SetAddresses::is_ours(const wire::Header& header, std::string_view engine) {
  const std::string_view key = header.latch_key() == nullptr ? std::string_view() : header.latch_key()->string_view();
  if (key.empty()) return asker_epoch_ != header.epoch() || header.source()->string_view() != asker_;
  if (key != engine) return false;
  asker_ = header.source()->str();
  asker_epoch_ = header.epoch();
  return true;
}

std::vector<splatbus_camera_request> read_requests(const wire::EngineCameras& root, const bus::Message& message,
                                                   bus::LogLimiter& limiter) {
  std::vector<splatbus_camera_request> requests;
  if (root.cameras() == nullptr) return requests;
  std::size_t refused = 0;
  std::string first_wrong;
  const auto refuse = [&](std::string wrong) {
    if (++refused == 1) first_wrong = std::move(wrong);
  };
  for (const wire::CameraRequest* entry : *root.cameras()) {
    const wire::Camera& camera = *entry->camera();
    splatbus_camera_request request;
    std::memset(&request, 0, sizeof(request));  // padding too: sets are compared as bytes
    request.camera = {.id = camera.id(),
                      .role = static_cast<std::uint32_t>(camera.role()),
                      .width = camera.width(),
                      .height = camera.height(),
                      .fx = camera.fx(),
                      .fy = camera.fy(),
                      .cx = camera.cx(),
                      .cy = camera.cy(),
                      .near_m = camera.near_m(),
                      .far_m = camera.far_m(),
                      .world_from_camera = from_wire(camera.world_from_camera())};
    request.buffers = static_cast<std::uint32_t>(entry->buffers());
    request.rate_hz = entry->rate_hz();
    request.request_id = entry->request_id();
    request.light_id = entry->light_id();
    request.light_map = entry->light_map();
    request.extent_m = entry->extent_m();
    if (requests.size() == kMaxCameras) {
      refuse(fmt::format("more than {} cameras", kMaxCameras));
      break;
    }
    if (std::string wrong = problem(request); !wrong.empty()) {
      refuse(std::move(wrong));
      continue;
    }
    requests.push_back(request);
  }
  if (refused > 0 && limiter.allow()) {
    spdlog::warn("{} from {}: {} of its requests left out: {}", message.topic(),
                 bus::printable(message.header().source()->string_view()), refused, first_wrong);
  }
  return requests;
}

flatbuffers::Offset<wire::EngineFrame> build_frame(flatbuffers::FlatBufferBuilder& builder,
                                                   flatbuffers::Offset<wire::Header> header,
                                                   const splatbus_frame& frame) {
  const splatbus_light& light = frame.light;
  const wire::Vec3 sun_direction = to_wire(light.sun_direction);
  const wire::Vec3 sun_irradiance = to_wire(light.sun_irradiance);
  const wire::Vec3 background = to_wire(light.background);
  const auto ambient = builder.CreateVector(light.ambient_sh, 27);
  const std::vector<splatbus_light_source> sources_now = sources_of(light);
  const auto sources = builder.CreateVectorOfStructs(to_wire(sources_now));
  const auto light_offset = wire::CreateLight(builder, light_hash(light, sources_now), ambient, &sun_direction,
                                              &sun_irradiance, &background, sources, light.sun_depth_version);
  std::vector<wire::ObjectTransform> objects;
  for (const splatbus_object& object : std::span(frame.objects, frame.object_count)) {
    objects.emplace_back(object.id, to_wire(object.world_from_object), object.scale,
                         static_cast<wire::ObjectFlags>(object.flags));
  }
  const auto objects_offset = builder.CreateVectorOfStructs(objects);
  const wire::Camera camera = to_wire(frame.camera);
  const auto scene = wire::CreateSceneState(builder, frame.frame, frame.time_s, objects_offset, light_offset);
  return wire::CreateEngineFrame(builder, header, frame.request_id, &camera, scene, frame.light_id,
                                 static_cast<std::uint8_t>(frame.light_map));
}

}  // namespace splatbus::engine_sdk
