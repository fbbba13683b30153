#include "capture-bridge/scene_versions.h"

#include <algorithm>
#include <ranges>
#include <utility>

#include "gaussians/player.h"

namespace splatbus::capture_bridge {

namespace {

/// Without what each engine names by itself.
Light unnamed(Light light) {
  light.generation = 0;
  light.sun_depth_version = 0;
  for (LightSource& source : light.sources) source.depth_version = 0;
  return light;
}

bool same_objects(const ObjectTransforms& a, const ObjectTransforms& b) {
  const auto shows = [](const auto& object) { return object.first != kPlayerId; };
  return std::ranges::equal(a | std::views::filter(shows), b | std::views::filter(shows));
}

}  // namespace

SceneVersions::SceneVersions(std::uint64_t before) {
  versions_.push_back({.state = std::make_shared<const SceneState>(SceneState{.version = before})});
}

void SceneVersions::add(SceneState state) {
  if (!std::exchange(any_, true)) versions_.clear();
  versions_.push_back({.state = std::make_shared<const SceneState>(std::move(state))});
  if (versions_.size() > kMost) versions_.pop_front();
}

void SceneVersions::seen(std::uint64_t frame, double time_s) {
  versions_.back().frame = frame;
  versions_.back().time_s = time_s;
}

const SceneVersion* SceneVersions::showing(const SceneState& state) const {
  if (!any_) return nullptr;
  const Light light = unnamed(state.light);
  for (auto version = versions_.rbegin(); version != versions_.rend(); ++version) {
    const SceneState& known = *version->state;
    if (unnamed(known.light) == light && same_objects(known.objects, state.objects)) return &*version;
  }
  return nullptr;
}

}  // namespace splatbus::capture_bridge
