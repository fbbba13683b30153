#include "capture-bridge/scene_versions.h"

#include <algorithm>
#include <iterator>
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

/// But for the player's camera.
bool same_objects(const ObjectTransforms& a, const ObjectTransforms& b) {
  const auto shown = [](auto object, const ObjectTransforms& of) {
    return object != of.end() && object->first == kPlayerId ? std::next(object) : object;
  };
  auto p = shown(a.begin(), a), q = shown(b.begin(), b);
  for (; p != a.end() && q != b.end(); p = shown(std::next(p), a), q = shown(std::next(q), b)) {
    if (*p != *q) return false;
  }
  return p == a.end() && q == b.end();
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
  const auto found = std::find_if(versions_.rbegin(), versions_.rend(), [&](const SceneVersion& version) {
    return unnamed(version.state->light) == light && same_objects(version.state->objects, state.objects);
  });
  return found == versions_.rend() ? nullptr : &*found;
}

}  // namespace splatbus::capture_bridge
