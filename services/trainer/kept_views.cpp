#include "trainer/kept_views.h"

#include <algorithm>
#include <cmath>
#include <memory>

namespace splatbus::trainer {

namespace {

const glm::vec3& place_of(const Camera& camera) {
  return camera.world_from_camera.translation;
}

float turned_radians(const Camera& a, const Camera& b) {
  return 2 * std::acos(std::min(1.0F, std::abs(glm::dot(a.world_from_camera.rotation, b.world_from_camera.rotation))));
}

}  // namespace

bool same_kind(const TrainingView& a, const TrainingView& b) {
  return a.scene.version == b.scene.version && a.camera.width == b.camera.width && a.camera.height == b.camera.height;
}

bool KeptViews::show_the_same(const Camera& a, const Camera& b) const {
  return glm::distance(place_of(a), place_of(b)) < limits_.apart_m && turned_radians(a, b) < limits_.apart_radians;
}

void KeptViews::keep(const TrainingView& view) {
  const auto shows_it = [&](const auto& kept) { return show_the_same(kept.second->camera, view.camera); };
  if (view.depth.empty() || view.bytes() > limits_.bytes || std::ranges::any_of(views_, shows_it)) return;
  make_room(view);
  TrainingView kept = view;
  kept.kept_number = ++numbers_;
  bytes_ += kept.bytes();
  views_.emplace(kept.kept_number, std::make_shared<const TrainingView>(std::move(kept)));
}

void KeptViews::make_room(const TrainingView& view) {
  const auto distance_m = [&](const auto& kept) {
    return glm::distance(place_of(kept.second->camera), place_of(view.camera));
  };
  while (!views_.empty() && (views_.size() >= limits_.views || bytes_ + view.bytes() > limits_.bytes)) {
    const auto farthest = std::ranges::max_element(views_, {}, distance_m);
    bytes_ -= farthest->second->bytes();
    views_.erase(farthest);
  }
}

void KeptViews::see(const TrainingView& newer) {
  if (!views_.empty() && !same_kind(*views_.begin()->second, newer)) clear();
}

void KeptViews::clear() {
  views_.clear();
  bytes_ = 0;
}

void KeptViews::drop(std::span<const std::uint32_t> numbers) {
  for (const std::uint32_t number : numbers) {
    const auto found = views_.find(number);
    if (found == views_.end()) continue;
    bytes_ -= found->second->bytes();
    views_.erase(found);
  }
}

std::vector<TrainingViewPtr> KeptViews::some_about(const Camera& camera, float reach_m, std::size_t most) {
  std::vector<TrainingViewPtr> some;
  auto at = views_.upper_bound(last_given_);
  for (std::size_t looked = 0; looked < views_.size() && some.size() < most; ++looked, ++at) {
    if (at == views_.end()) at = views_.begin();
    if (glm::distance(place_of(at->second->camera), place_of(camera)) > reach_m) continue;
    some.push_back(at->second);
    last_given_ = at->first;
  }
  return some;
}

std::vector<ViewKey> KeptViews::keys(std::span<const Camera> cameras, float reach_m) const {
  std::vector<ViewKey> keys;
  for (const auto& [number, view] : views_) {
    const Camera& kept = view->camera;
    const bool near = std::ranges::any_of(
        cameras, [&](const Camera& camera) { return glm::distance(place_of(camera), place_of(kept)) <= reach_m; });
    const bool shown = std::ranges::any_of(cameras, [&](const Camera& camera) { return show_the_same(camera, kept); });
    if (near && !shown) keys.push_back(key_of(*view));
  }
  return keys;
}

TrainingViewPtr KeptViews::find(const ViewKey& key) const {
  const auto found = views_.find(key.kept_number);
  return found == views_.end() ? nullptr : found->second;
}

}  // namespace splatbus::trainer
