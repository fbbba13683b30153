#include <algorithm>
#include <vector>

#include "device/buffer.h"
#include "device/parallel.h"
#include "gaussians/portable.h"
#include "relight/light_test.h"
#include "relight/visibility.h"

namespace splatbus::relight {

namespace {

using math::Vec3;

constexpr std::int32_t kStill = -1, kOfGaussian = -2;

/// Neighbouring indices, within one page.
struct Tier {
  std::uint32_t first, count;
  std::int32_t frame;  ///< of `frames`, or kStill, or kOfGaussian: each has its own
  std::uint64_t kept;  ///< lights whose earlier values hold
};

/// Tests Gaussians against all lights.
struct VisibilityTest {
  GaussiansView gaussians;
  const Tier* tiers;
  const math::Similarity* frames;  ///< world_from_object
  const std::uint32_t* frame_ids;  ///< of `frames`, ascending
  std::uint32_t frame_count;
  const LightView* lights;
  std::uint32_t light_count;
  VisibilityOptions options;
  const std::uint8_t* before;
  std::size_t before_stride;
  const std::int32_t* before_row;  ///< of each light
  std::uint8_t* visibility;

  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER Surface surface(const Tier& tier, std::uint32_t i) const {
    Surface out{vector_at(gaussians.surface_point, i), vector_at(gaussians.normal, i), 0};
    if (gaussians.parameters != nullptr) {
      const Vec3 moved = vector_at(gaussians.parameters, i) - out.point;
      out.point = out.point + moved - out.normal * math::dot(out.normal, moved);
    }
    float deviation_m = surface_deviation_m(i);
    const std::int32_t index = tier.frame == kOfGaussian ? frame_of(gaussians.object_id[i]) : tier.frame;
    if (index != kStill) {
      const math::Similarity& frame = frames[index];
      out.point = transformed(frame, out.point);
      out.normal = frame.rotation * out.normal;
      deviation_m *= frame.scale;
    }
    const float footprint_m = options.footprint * math::smaller(deviation_m, kMaxDeviation_m);
    out.radius_m = kParaboloidOverDisc * (options.softness_m + footprint_m);
    return out;
  }

  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER std::uint8_t kept_value(std::uint32_t light, std::uint32_t i) const {
    return before[static_cast<std::size_t>(before_row[light]) * before_stride + i];
  }
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER std::uint8_t& value(std::uint32_t light, std::uint32_t i) const {
    return visibility[light * gaussians.count + i];
  }

 private:
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER Vec3 vector_at(const float* channels, std::uint32_t i) const {
    const float* const first = channels + gaussians.offset(i);
    return {first[0], first[gaussians.stride], first[2 * gaussians.stride]};
  }

  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER std::int32_t frame_of(std::uint32_t id) const {
    std::uint32_t low = 0, high = frame_count;
    while (low < high) {
      const std::uint32_t middle = (low + high) / 2;
      frame_ids[middle] < id ? low = middle + 1 : high = middle;
    }
    return low < frame_count && frame_ids[low] == id ? static_cast<std::int32_t>(low) : kStill;
  }

  /// Mean of the two larger standard deviations: a flat Gaussian's extent on its surface.
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER float surface_deviation_m(std::uint32_t i) const {
    if (gaussians.parameters == nullptr) return 0;
    const float* const log_scale = gaussians.at(ParameterLayout::kLogScale, i);
    const float a = log_scale[0], b = log_scale[gaussians.stride], c = log_scale[2 * gaussians.stride];
    if (a + b + c != a + b + c) return kMaxDeviation_m;
    const float largest = math::larger(math::larger(a, b), c);
    const float middle = math::larger(math::smaller(a, b), math::smaller(math::larger(a, b), c));
    return 0.5F * (quick_exp(middle) + quick_exp(largest));
  }
};

/// On a GPU an item is a Gaussian.
struct OneGaussian {
  VisibilityTest test;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t item) const {
    const Tier& tier = test.tiers[item / kTierLanes];
    if (item % kTierLanes >= tier.count) return;
    const std::uint32_t i = tier.first + item % kTierLanes;
    const Surface surface = test.surface(tier, i);
    for (std::uint32_t light = 0; light < test.light_count; ++light) {
      const bool kept = (tier.kept >> light & 1U) != 0;
      test.value(light, i) =
          kept ? test.kept_value(light, i) : seen_share(test.lights[light], surface, test.options.lift_texels);
    }
  }
};

/// On a CPU it is a tier, light by light: a light's code and its part of the map stay in the cache.
struct OneTier {
  VisibilityTest test;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t item) const {
    const Tier& tier = test.tiers[item];
    Surface surfaces[kTierLanes];
    const bool all_kept = (~tier.kept & ((std::uint64_t{1} << (test.light_count - 1) << 1) - 1)) == 0;
    for (std::uint32_t k = 0; !all_kept && k < tier.count; ++k) surfaces[k] = test.surface(tier, tier.first + k);
    for (std::uint32_t light = 0; light < test.light_count; ++light) {
      const LightView& view = test.lights[light];
      const bool kept = (tier.kept >> light & 1U) != 0;
      for (std::uint32_t k = 0; k < tier.count; ++k) {
        const std::uint32_t i = tier.first + k;
        test.value(light, i) =
            kept ? test.kept_value(light, i) : seen_share(view, surfaces[k], test.options.lift_texels);
      }
    }
  }
};

void append_tiers(const IndexRange& range, std::int32_t frame, std::uint64_t kept, std::vector<Tier>& tiers) {
  for (std::uint32_t k = 0; k < range.count; k += kTierLanes) {
    tiers.push_back({range.first + k, std::min(kTierLanes, range.count - k), frame, kept});
  }
}

std::vector<Tier> tiers_of(const GaussiansView& gaussians, const std::vector<std::uint32_t>& frame_ids,
                           const KeptRows& kept) {
  const auto kept_of = [&](std::size_t page) { return kept.lights_of_page.empty() ? 0 : kept.lights_of_page[page]; };
  std::vector<Tier> tiers;
  if (!gaussians.has_pages()) {
    const std::int32_t frame = gaussians.object_id != nullptr ? kOfGaussian : kStill;
    append_tiers({0, static_cast<std::uint32_t>(gaussians.count)}, frame, kept_of(0), tiers);
    return tiers;
  }
  for (const IndexRange& range : gaussians.ranges) {
    const auto found = std::lower_bound(frame_ids.begin(), frame_ids.end(), range.frame_id);
    const bool moved = found != frame_ids.end() && *found == range.frame_id;
    const auto frame = moved ? static_cast<std::int32_t>(found - frame_ids.begin()) : kStill;
    append_tiers(range, frame, kept_of(range.first >> gaussians.page_shift), tiers);
  }
  return tiers;
}

MapView view_of(const LightDepthMap& map) {
  const Camera& camera = map.camera;
  return {.camera_from_world = portable(inverse(camera.world_from_camera)),
          .fx = camera.fx,
          .fy = camera.fy,
          .cx = camera.cx,
          .cy = camera.cy,
          .texel = 1.0F / math::smaller(camera.fx, camera.fy),
          .width = static_cast<int>(camera.width),
          .height = static_cast<int>(camera.height),
          .depth_m = map.depth_m};
}

LightView view_of(const LightSource& source, const MapView* maps, std::size_t map_count) {
  return {.kind = source.kind,
          .casts_shadow = source.casts_shadow,
          .position = portable(source.position),
          .axis = portable(source.direction),
          .range2_m2 = source.range_m * source.range_m,
          .cos_outer = source.cos_outer,
          .maps = maps,
          .map_count = static_cast<std::uint32_t>(map_count)};
}

template <class T>
device::Buffer<T> placed(device::StreamView stream, std::span<const T> values) {
  device::Buffer<T> buffer(stream);
  buffer.assign(values);
  return buffer;
}

}  // namespace

LightSource sun_source(const Light& light) {
  return {.id = 0,
          .kind = LightKind::Directional,
          .casts_shadow = light.sun_irradiance != glm::vec3(0),
          .direction = light.sun_direction,
          .intensity = light.sun_irradiance,
          .depth_version = light.sun_depth_version};
}

void compute_visibility(device::StreamView stream, const GaussiansView& gaussians, const ObjectTransforms& objects,
                        std::span<const MappedLight> lights, const VisibilityOptions& options, std::uint8_t* visibility,
                        const KeptRows& kept) {
  if (lights.empty() || gaussians.count == 0) return;
  std::vector<math::Similarity> frames;
  std::vector<std::uint32_t> frame_ids;
  for (const auto& [id, world_from_object] : objects) {
    frames.push_back(portable(world_from_object));
    frame_ids.push_back(id);
  }
  std::vector<MapView> maps;
  for (const MappedLight& light : lights) {
    for (const LightDepthMap& map : light.maps) maps.push_back(view_of(map));
  }
  const std::vector<Tier> tiers = tiers_of(gaussians, frame_ids, kept);
  if (tiers.empty()) return;
  const auto map_table = placed<MapView>(stream, maps);
  std::vector<LightView> views;
  std::size_t first_map = 0;
  for (const MappedLight& light : lights) {
    views.push_back(view_of(light.source, map_table.data() + first_map, light.maps.size()));
    first_map += light.maps.size();
  }
  const auto tier_table = placed<Tier>(stream, tiers);
  const auto frame_table = placed<math::Similarity>(stream, frames);
  const auto id_table = placed<std::uint32_t>(stream, frame_ids);
  const auto light_table = placed<LightView>(stream, views);
  const auto row_table = placed<std::int32_t>(stream, kept.row);
  const VisibilityTest test{.gaussians = gaussians,
                            .tiers = tier_table.data(),
                            .frames = frame_table.data(),
                            .frame_ids = id_table.data(),
                            .frame_count = static_cast<std::uint32_t>(frames.size()),
                            .lights = light_table.data(),
                            .light_count = static_cast<std::uint32_t>(lights.size()),
                            .options = options,
                            .before = kept.values,
                            .before_stride = kept.stride,
                            .before_row = row_table.data(),
                            .visibility = visibility};
  const auto tier_count = static_cast<std::uint32_t>(tiers.size());
  if (stream.on_cuda()) {
    device::for_each_index(stream, tier_count * kTierLanes, OneGaussian{test});
  } else {
    device::for_each_index(stream, tier_count, OneTier{test});
  }
  stream.wait();
}

}  // namespace splatbus::relight
