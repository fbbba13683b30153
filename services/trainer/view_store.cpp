#include "trainer/view_store.h"

#include <algorithm>
#include <utility>

namespace splatbus::trainer {

ViewStore::ViewStore(std::size_t max_views, std::size_t max_bytes) : max_views_(max_views), max_bytes_(max_bytes) {}

void ViewStore::put(TrainingViewPtr view) {
  const ViewKey key = key_of(*view);
  const std::scoped_lock lock(mutex_);
  const auto [place, is_new] = views_.try_emplace(key);
  Entry& entry = place->second;
  if (is_new) {
    ++cameras_version_;
  } else {
    bytes_ -= entry.view->bytes();
  }
  bytes_ += view->bytes();
  newest_light_ = view->scene.light.generation;
  entry.view = std::move(view);
  entry.updated = ++updates_;
  evict(key);
}

void ViewStore::evict(const ViewKey& newest) {
  while (views_.size() > 1 && (views_.size() > max_views_ || bytes_ > max_bytes_)) {
    auto oldest = views_.end();
    for (auto it = views_.begin(); it != views_.end(); ++it) {
      const bool older = oldest == views_.end() || it->second.updated < oldest->second.updated;
      if (it->first != newest && older) oldest = it;
    }
    bytes_ -= oldest->second.view->bytes();
    views_.erase(oldest);
    ++cameras_version_;
  }
}

void ViewStore::retire(const ViewKey& key) {
  const std::scoped_lock lock(mutex_);
  const auto found = views_.find(key);
  if (found == views_.end()) return;
  bytes_ -= found->second.view->bytes();
  views_.erase(found);
  ++cameras_version_;
}

TrainingViewPtr ViewStore::find(const ViewKey& key) const {
  const std::scoped_lock lock(mutex_);
  const auto found = views_.find(key);
  return found == views_.end() ? nullptr : found->second.view;
}

std::vector<ViewKey> ViewStore::keys(CameraRole role) const {
  const std::scoped_lock lock(mutex_);
  std::vector<ViewKey> keys;
  for (const auto& [key, entry] : views_) {
    if (key.role == role) keys.push_back(key);
  }
  return keys;
}

bool ViewStore::any_to_train(CameraRole role) const {
  const std::scoped_lock lock(mutex_);
  return std::any_of(views_.begin(), views_.end(), [&](const auto& view) { return view.first.role == role; });
}

std::size_t ViewStore::count(CameraRole role) const {
  const std::scoped_lock lock(mutex_);
  return static_cast<std::size_t>(
      std::count_if(views_.begin(), views_.end(), [&](const auto& view) { return view.first.role == role; }));
}

std::optional<std::uint64_t> ViewStore::reference_light() const {
  const std::scoped_lock lock(mutex_);
  const bool ready = std::any_of(views_.begin(), views_.end(), [&](const auto& view) {
    const Entry& entry = view.second;
    return view.first.role == CameraRole::Reference && entry.view->scene.light.generation == newest_light_;
  });
  return ready ? std::optional(newest_light_) : std::nullopt;
}

std::size_t ViewStore::bytes() const {
  const std::scoped_lock lock(mutex_);
  return bytes_;
}

std::uint64_t ViewStore::cameras_version() const {
  const std::scoped_lock lock(mutex_);
  return cameras_version_;
}

}  // namespace splatbus::trainer
