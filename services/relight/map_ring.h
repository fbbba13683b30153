#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <vector>

#include "gaussians/light.h"

namespace splatbus::wire {
struct SceneLightDepth;
}  // namespace splatbus::wire

namespace splatbus::relight {

/// All depth maps of one depth_version of a light.
struct LightMaps {
  struct Map {
    Camera camera;
    std::shared_ptr<const std::byte> depth_m;  ///< null until it has come
  };
  std::uint64_t depth_version = 0;
  std::uint64_t revision = 0;       ///< of all lights' maps: another one whenever one of these is
  std::uint64_t scene_version = 0;  ///< of the map that came last
  std::vector<Map> maps;            ///< by light_map

  [[nodiscard]] bool complete() const;
};

/// The depth maps of the last few depth versions of each light. What it hands out stays as it is.
class MapRing {
 public:
  static constexpr std::size_t kMaxVersions = 8;  // pictures come within a frame or two of their maps

  /// Which map.
  struct Key {
    std::uint32_t light_id = 0;
    std::uint64_t depth_version = 0;
    std::uint32_t light_map = 0, light_maps = 1;  ///< which of how many that make the light's depth_version
  };
  /// Of a message. Throws std::runtime_error, naming what is wrong, for a light that casts no shadow, and for a map
  /// that is none of the light's.
  [[nodiscard]] static Key key_of(const wire::SceneLightDepth& depth);
  /// Whether that map, through a camera with this projection, is there.
  [[nodiscard]] bool holds(const Key& key, const Camera& camera) const;
  void put(const Key& key, LightMaps::Map map, std::uint64_t scene_version);

  /// Null until all its maps are there.
  [[nodiscard]] std::shared_ptr<const LightMaps> find(std::uint32_t light_id, std::uint64_t depth_version) const;
  /// Whether the light has all maps of a scene after that version: maps come in the order of their scenes.
  [[nodiscard]] bool is_past(std::uint32_t light_id, std::uint64_t scene_version) const;
  /// Whether any map of the light is there.
  [[nodiscard]] bool knows(std::uint32_t light_id) const { return of_light_.contains(light_id); }
  /// Forgets lights that are not in a scene.
  void keep(const Light& light);

 private:
  [[nodiscard]] std::shared_ptr<const LightMaps> newest_of(std::uint32_t light_id, std::uint64_t depth_version) const;

  std::map<std::uint32_t, std::deque<std::shared_ptr<const LightMaps>>> of_light_;
  std::uint64_t revision_ = 0;
};

}  // namespace splatbus::relight
