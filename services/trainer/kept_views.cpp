#include "trainer/kept_views.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <span>
#include <utility>

namespace splatbus::trainer {

namespace {

/// Who tells views apart by their cameras is to tell these from what the camera sees now.
constexpr std::uint32_t kKeptIds = 1U << 31U;

const glm::vec3& place_of(const Camera& camera) {
  return camera.world_from_camera.translation;
}

float distance_m(const Camera& a, const Camera& b) {
  return glm::distance(place_of(a), place_of(b));
}

float turned_radians(const Camera& a, const Camera& b) {
  return 2 * std::acos(std::min(1.0F, std::abs(glm::dot(a.world_from_camera.rotation, b.world_from_camera.rotation))));
}

/// Tangents of half the picture's height, one in the other.
float zoom(const Camera& a, const Camera& b) {
  const float ratio = static_cast<float>(a.height) / a.fy / (static_cast<float>(b.height) / b.fy);
  return std::max(ratio, 1 / ratio);
}

}  // namespace

bool KeptViews::show_the_same(const Camera& a, const Camera& b) const {
  return distance_m(a, b) < limits_.apart_m && turned_radians(a, b) < limits_.apart_radians &&
         zoom(a, b) < limits_.apart_zoom;
}

KeptViews::Views::iterator KeptViews::take_out(Views::iterator at, std::vector<TrainingViewPtr>& gone) {
  bytes_ -= at->second.view->bytes();
  gone.push_back(std::move(at->second.view));
  return views_.erase(at);
}

KeptViews::Views::iterator KeptViews::farthest(std::span<const Camera> cameras) {
  return std::ranges::max_element(views_, {}, [&](const auto& kept) {
    float nearest_m = std::numeric_limits<float>::infinity();
    for (const Camera& camera : cameras) nearest_m = std::min(nearest_m, distance_m(camera, kept.second.view->camera));
    return nearest_m;
  });
}

std::vector<TrainingViewPtr> KeptViews::keep(const TrainingView& view, std::span<const Camera> cameras) {
  std::vector<TrainingViewPtr> gone;
  if (view.scene.version != scene_version_ || view.depth.empty() || view.bytes() > limits_.bytes) return gone;
  const auto now = Clock::now();
  const auto same = std::ranges::find_if(
      views_, [&](const auto& kept) { return show_the_same(kept.second.view->camera, view.camera); });
  if (same != views_.end()) {
    if (now - same->second.since < limits_.lasts) return gone;
    take_out(same, gone);
  }
  while (!views_.empty() && (views_.size() >= limits_.views || bytes_ + view.bytes() > limits_.bytes)) {
    take_out(farthest(cameras), gone);
  }
  TrainingView kept = view;
  const std::uint32_t number = ++numbers_;
  kept.kept_number = number;
  kept.camera.id = kKeptIds | number;
  bytes_ += kept.bytes();
  views_.emplace(number, Kept{.view = std::make_shared<const TrainingView>(std::move(kept)), .since = now});
  return gone;
}

std::vector<TrainingViewPtr> KeptViews::see(std::uint64_t scene_version) {
  if (scene_version <= scene_version_) return {};
  scene_version_ = scene_version;
  return clear();
}

std::vector<TrainingViewPtr> KeptViews::clear() {
  std::vector<TrainingViewPtr> gone;
  for (auto at = views_.begin(); at != views_.end();) at = take_out(at, gone);
  return gone;
}

std::vector<TrainingViewPtr> KeptViews::drop(std::span<const std::uint32_t> numbers) {
  std::vector<TrainingViewPtr> gone;
  for (const std::uint32_t number : numbers) {
    if (const auto found = views_.find(number); found != views_.end()) take_out(found, gone);
  }
  return gone;
}

std::vector<TrainingViewPtr> KeptViews::some_about(const TrainingView& view, float reach_m, std::size_t most) {
  if (view.scene.version != scene_version_) return {};
  std::vector<Kept*> about;
  for (auto& [number, kept] : views_) {
    if (distance_m(kept.view->camera, view.camera) <= reach_m) about.push_back(&kept);
  }
  std::ranges::stable_sort(about, {}, &Kept::asked);
  ++asked_;
  std::vector<TrainingViewPtr> some;
  for (Kept* const kept : std::span(about).first(std::min(most, about.size()))) {
    kept->asked = asked_;
    some.push_back(kept->view);
  }
  return some;
}

std::vector<ViewKey> KeptViews::keys(std::span<const Camera> cameras, float reach_m) const {
  std::vector<ViewKey> keys;
  for (const auto& [number, one] : views_) {
    const Camera& kept = one.view->camera;
    const bool near =
        std::ranges::any_of(cameras, [&](const Camera& camera) { return distance_m(camera, kept) <= reach_m; });
    if (!near) continue;
    const bool shown = std::ranges::any_of(cameras, [&](const Camera& camera) { return show_the_same(camera, kept); });
    if (!shown) keys.push_back(key_of(*one.view));
  }
  return keys;
}

TrainingViewPtr KeptViews::find(const ViewKey& key) const {
  const auto found = views_.find(key.kept_number);
  return found == views_.end() ? nullptr : found->second.view;
}

}  // namespace splatbus::trainer
