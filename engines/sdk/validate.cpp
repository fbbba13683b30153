#include "sdk/validate.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <span>
#include <vector>

#include "sdk/image_memory.h"
#include "wire/picture_size.h"

namespace splatbus::engine_sdk {
namespace {

constexpr std::uint32_t kAllBuffers = 127;
constexpr std::uint32_t kLastLightMap = 255;  // a byte on the bus
constexpr std::uint32_t kAllObjectFlags = SPLATBUS_OBJECT_EMISSIVE | SPLATBUS_OBJECT_NOT_MODELLED;
constexpr float kUnitTolerance = 1e-2F;

bool finite(std::span<const float> values) {
  return std::ranges::all_of(values, [](float value) { return std::isfinite(value); });
}

float norm(std::span<const float> values) {
  float sum = 0;
  for (const float value : values) sum += value * value;
  return std::sqrt(sum);
}

std::string problem_of_size(const splatbus_camera& camera) {
  if (is_picture_size(camera.width, camera.height)) return {};
  return fmt::format("{} x {} pixels, where each side has 1 to {}", camera.width, camera.height, kMaxPictureSide);
}

std::string problem(const splatbus_rigid& pose, const char* name) {
  if (!finite(pose.translation)) return fmt::format("{}.translation is not finite", name);
  if (!finite(pose.rotation_wxyz)) return fmt::format("{}.rotation_wxyz is not finite", name);
  const float length = norm(pose.rotation_wxyz);
  if (std::abs(length - 1) > kUnitTolerance)
    return fmt::format("{}.rotation_wxyz is not a unit quaternion (norm {:.4g})", name, length);
  return {};
}

std::string problem_of_radiance(std::span<const float> values, const char* name) {
  if (!finite(values)) return fmt::format("light: {} is not finite", name);
  const auto negative = std::ranges::find_if(values, [](float value) { return value < 0; });
  if (negative == values.end()) return {};
  return fmt::format("light: {}[{}] is {:.4g}, below 0", name, negative - values.begin(), *negative);
}

std::string problem(const splatbus_light_source& source) {
  if (source.id == 0) return "0 is the sun";
  if (source.kind > SPLATBUS_LIGHT_SPOT) return fmt::format("{} is not a kind of light", source.kind);
  if (!finite(source.intensity)) return "intensity is not finite";
  if (std::ranges::any_of(source.intensity, [](float value) { return value < 0; })) return "intensity is below 0";
  const bool directional = source.kind == SPLATBUS_LIGHT_DIRECTIONAL, spot = source.kind == SPLATBUS_LIGHT_SPOT;
  if (directional || spot) {
    if (!finite(source.direction)) return "direction is not finite";
    const float length = norm(source.direction);
    if (std::abs(length - 1) > kUnitTolerance) return fmt::format("direction is not unit (norm {:.4g})", length);
  }
  if (directional) return {};
  if (!finite(source.position)) return "position is not finite";
  if (!std::isfinite(source.range_m) || source.range_m <= 0)
    return fmt::format("range_m is {}, not above 0", source.range_m);
  if (spot && !(source.cos_outer >= -1 && source.cos_outer < source.cos_inner && source.cos_inner <= 1)) {
    return fmt::format("cos_outer {} and cos_inner {} do not make a cone", source.cos_outer, source.cos_inner);
  }
  return {};
}

std::string problem(const splatbus_light& light) {
  if (!finite(light.ambient_sh)) return "light: ambient_sh is not finite";
  for (const std::size_t mean : {0U, 9U, 18U}) {
    if (light.ambient_sh[mean] < 0) {
      return fmt::format("light: ambient_sh[{}], a mean over all directions, is {:.4g}, below 0", mean,
                         light.ambient_sh[mean]);
    }
  }
  if (!finite(light.sun_direction)) return "light: sun_direction is not finite";
  const float length = norm(light.sun_direction);
  if (std::abs(length - 1) > kUnitTolerance)
    return fmt::format("light: sun_direction is not unit (norm {:.4g})", length);
  if (std::string wrong = problem_of_radiance(light.sun_irradiance, "sun_irradiance"); !wrong.empty()) return wrong;
  if (std::string wrong = problem_of_radiance(light.background, "background"); !wrong.empty()) return wrong;
  if (light.source_count > 0 && light.sources == nullptr) return "light: sources is NULL";
  if (light.source_count > SPLATBUS_MAX_LIGHTS)
    return fmt::format("light: {} sources, at most {} are allowed", light.source_count, SPLATBUS_MAX_LIGHTS);
  std::vector<std::uint32_t> ids;
  for (const splatbus_light_source& source : std::span(light.sources, light.source_count)) {
    if (std::string wrong = problem(source); !wrong.empty()) return fmt::format("light {}: {}", source.id, wrong);
    if (std::ranges::count(ids, source.id) > 0) return fmt::format("light {} was given twice", source.id);
    ids.push_back(source.id);
  }
  return {};
}

/// Of a frame whose light makes sense: whether the light has such a depth map.
std::string problem_of_light_map(const splatbus_frame& frame) {
  if (frame.light_map > kLastLightMap)
    return fmt::format("light_map is {}, where {} is the last", frame.light_map, kLastLightMap);
  if (frame.light_id == 0) return {};
  const std::span sources(frame.light.sources, frame.light.source_count);
  const auto source = std::ranges::find(sources, frame.light_id, &splatbus_light_source::id);
  if (source == sources.end()) return fmt::format("light_id is {}, which is not a light of the frame", frame.light_id);
  if (source->casts_shadow == 0) return fmt::format("light {} casts no shadow: it has no depth maps", frame.light_id);
  if (source->kind == SPLATBUS_LIGHT_DIRECTIONAL) return {};
  const std::uint32_t last = source->kind == SPLATBUS_LIGHT_POINT ? 5 : 0;
  if (frame.light_map <= last) return {};
  return fmt::format("light_map is {}, where light {} has 0 to {}", frame.light_map, frame.light_id, last);
}

std::string problem(std::span<const splatbus_object> objects) {
  std::vector<std::uint32_t> ids;
  ids.reserve(objects.size());
  for (const splatbus_object& object : objects) {
    if (object.id == 0) return "object 0: 0 means no surface";
    if (object.id == SPLATBUS_RESERVED_ID) return fmt::format("object {:#x}: this id is reserved", object.id);
    if (std::string wrong = problem(object.world_from_object, "world_from_object"); !wrong.empty())
      return fmt::format("object {}: {}", object.id, wrong);
    if (!std::isnormal(object.scale) || object.scale <= 0)
      return fmt::format("object {}: scale is {}, not above 0", object.id, object.scale);
    if ((object.flags & ~kAllObjectFlags) != 0)
      return fmt::format("object {}: {:#x} are not flags of an object", object.id, object.flags);
    ids.push_back(object.id);
  }
  if (!std::ranges::is_sorted(ids)) std::ranges::sort(ids);
  const auto twice = std::ranges::adjacent_find(ids);
  return twice == ids.end() ? std::string() : fmt::format("object {} was given twice", *twice);
}

std::string problem(const splatbus_image& image, const splatbus_camera& camera) {
  const char* name = buffer_name(image.buffer);
  if (name == nullptr) return fmt::format("{:#x} is not one known buffer", image.buffer);
  if (image.data == nullptr) return fmt::format("{}: data is NULL", name);
  if (image.buffer == SPLATBUS_BUFFER_LIGHT_DEPTH && camera.role != SPLATBUS_ROLE_LIGHT) {
    return fmt::format("{}: only a camera of role light has one", name);
  }
  const std::size_t pixels = std::size_t{camera.width} * camera.height;
  const std::size_t expected = pixels * buffer_channels(image.buffer) * bus::element_bytes(buffer_type(image.buffer));
  if (image.bytes != expected) {
    return fmt::format("{}: {} bytes, where {} x {} pixels take {}", name, image.bytes, camera.width, camera.height,
                       expected);
  }
  const std::string wrong = memory_problem(image);
  return wrong.empty() ? wrong : fmt::format("{}: {}", name, wrong);
}

}  // namespace

const char* buffer_name(std::uint32_t buffer) {
  switch (buffer) {
    case SPLATBUS_BUFFER_COLOR:
      return "color";
    case SPLATBUS_BUFFER_WORLD_POSITION:
      return "world_position";
    case SPLATBUS_BUFFER_NORMAL:
      return "normal";
    case SPLATBUS_BUFFER_ALBEDO:
      return "albedo";
    case SPLATBUS_BUFFER_DEPTH:
      return "depth";
    case SPLATBUS_BUFFER_LIGHT_DEPTH:
      return "light_depth";
    case SPLATBUS_BUFFER_OBJECT_ID:
      return "object_id";
    default:
      return nullptr;
  }
}

std::size_t buffer_channels(std::uint32_t buffer) {
  const bool single =
      buffer == SPLATBUS_BUFFER_DEPTH || buffer == SPLATBUS_BUFFER_LIGHT_DEPTH || buffer == SPLATBUS_BUFFER_OBJECT_ID;
  return single ? 1 : 4;
}

bus::ElementType buffer_type(std::uint32_t buffer) {
  if (buffer == SPLATBUS_BUFFER_COLOR || buffer == SPLATBUS_BUFFER_ALBEDO) return bus::ElementType::U8;
  return buffer == SPLATBUS_BUFFER_OBJECT_ID ? bus::ElementType::U32 : bus::ElementType::F32;
}

std::string problem(const splatbus_camera& camera) {
  const auto named = [&](const std::string& what) {
    return fmt::format("camera {} (role {}): {}", camera.id, camera.role, what);
  };
  if (camera.role > SPLATBUS_ROLE_LIGHT) return named("there is no such role");
  if (std::string wrong = problem_of_size(camera); !wrong.empty()) return named(wrong);
  if (!finite(std::array{camera.fx, camera.fy, camera.cx, camera.cy}))
    return named("fx, fy, cx, cy are not all finite");
  if (camera.fx <= 0 || camera.fy <= 0) return named("fx and fy must be above 0");
  if (!finite(std::array{camera.near_m, camera.far_m})) return named("near_m and far_m are not both finite");
  if (camera.near_m < 0 || camera.far_m <= camera.near_m) return named("it must be 0 <= near_m < far_m");
  const std::string pose = problem(camera.world_from_camera, "world_from_camera");
  return pose.empty() ? pose : named(pose);
}

std::string problem(const splatbus_camera_request& request) {
  const splatbus_camera& camera = request.camera;
  if (camera.role == SPLATBUS_ROLE_LIGHT) {
    if (std::string wrong = problem_of_size(camera); !wrong.empty())
      return fmt::format("light camera {}: {}", camera.id, wrong);
    if (!std::isfinite(request.extent_m) || request.extent_m < 0)
      return fmt::format("light camera {}: extent_m is {}", camera.id, request.extent_m);
    if (request.extent_m > 0 && !finite(camera.world_from_camera.translation))
      return fmt::format("light camera {}: world_from_camera.translation is not finite", camera.id);
  } else if (std::string wrong = problem(camera); !wrong.empty()) {
    return wrong;
  }
  if (!std::isfinite(request.rate_hz) || request.rate_hz < 0) {
    return fmt::format("camera {} (role {}): rate_hz is {}", camera.id, camera.role, request.rate_hz);
  }
  if (request.buffers == 0 || (request.buffers & ~kAllBuffers) != 0) {
    return fmt::format("camera {} (role {}): {:#x} are not buffers", camera.id, camera.role, request.buffers);
  }
  return {};
}

std::string problem(const splatbus_frame& frame) {
  if (!std::isfinite(frame.time_s)) return "time_s is not finite";
  if (std::string wrong = problem(frame.light); !wrong.empty()) return wrong;
  if (frame.image_count > 0) {
    if (frame.images == nullptr) return "images is NULL";
    if (std::string wrong = problem(frame.camera); !wrong.empty()) return wrong;
    if (frame.camera.role == SPLATBUS_ROLE_LIGHT) {
      if (std::string wrong = problem_of_light_map(frame); !wrong.empty())
        return fmt::format("camera {} (role {}): {}", frame.camera.id, frame.camera.role, wrong);
    }
  }
  std::uint32_t seen = 0;
  for (const splatbus_image& image : std::span(frame.images, frame.image_count)) {
    if (std::string wrong = problem(image, frame.camera); !wrong.empty()) return wrong;
    if ((seen & image.buffer) != 0) return fmt::format("{} was given twice", buffer_name(image.buffer));
    seen |= image.buffer;
  }
  if (frame.object_count > 0 && frame.objects == nullptr) return "objects is NULL";
  if (frame.object_count > SPLATBUS_MAX_OBJECTS)
    return fmt::format("{} objects, at most {} are allowed", frame.object_count, SPLATBUS_MAX_OBJECTS);
  return problem(std::span(frame.objects, frame.object_count));
}

std::string problem(const splatbus_frame& frame, const EngineClock& last) {
  if (frame.frame < last.frame) return fmt::format("frame runs backwards: the last one was {}", last.frame);
  if (frame.time_s < last.time_s) return fmt::format("time_s runs backwards: {} after {}", frame.time_s, last.time_s);
  return {};
}

}  // namespace splatbus::engine_sdk
