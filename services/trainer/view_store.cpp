#include "trainer/view_store.h"

#include <algorithm>
#include <iterator>
#include <utility>

namespace splatbus::trainer {

namespace {

/// Of a reference camera: what is farther off shows hardly anything of where it stands.
constexpr float kKeptReach_m = 20;
/// Views that a new one is held against.
constexpr std::size_t kKeptAtOnce = 4;
/// What is kept has at most that part of the room of what cameras see now.
constexpr std::size_t kKeptPart = 2;

}  // namespace

ViewStore::ViewStore(std::size_t max_views, std::size_t max_bytes)
    : max_views_(max_views),
      max_bytes_(max_bytes),
      kept_({.bytes = std::min(KeptViews::Limits().bytes, max_bytes / kKeptPart)}) {}

bool ViewStore::is_paired(const TrainingView& view) const {
  if (!paired_) return true;
  const auto found = std::ranges::lower_bound(*paired_, view.scene.version, {}, &PairedVersion::version);
  return found != paired_->end() && found->version == view.scene.version &&
         found->light_ids == light_ids(view.scene.light);
}

void ViewStore::replace(TrainingViewPtr& old, TrainingViewPtr view) {
  if (old) bytes_ -= old->bytes();
  if (view) bytes_ += view->bytes();
  old = std::move(view);
}

std::vector<Camera> ViewStore::reference_cameras() const {
  std::vector<Camera> cameras;
  for (const auto& [key, entry] : views_) {
    if (key.role == CameraRole::Reference && entry.view) cameras.push_back(entry.view->camera);
  }
  return cameras;
}

ViewStore::Views ViewStore::succeed(Entry& entry, TrainingViewPtr view) {
  const TrainingViewPtr before = entry.view;
  replace(entry.view, std::move(view));
  if (!keeps_ || !before || before->camera.role != CameraRole::Reference) return {};
  return kept_.keep(*before, reference_cameras());
}

void ViewStore::set_keeps(bool keeps) {
  Views gone;  // freed without the lock
  const std::scoped_lock lock(mutex_);
  keeps_ = keeps;
  if (!keeps) gone = kept_.clear();
}

void ViewStore::put(TrainingViewPtr view) {
  const ViewKey key = key_of(*view);
  Views gone, replaced;  // freed without the lock
  const std::scoped_lock lock(mutex_);
  if (key.role == CameraRole::Reference) gone = kept_.see(view->scene.version);
  const auto [place, is_new] = views_.try_emplace(key);
  Entry& entry = place->second;
  if (is_new) ++cameras_version_;
  if (entry.waiting && !entry.waits_again) ++unpaired_;
  const bool paired = is_paired(*view);
  replace(entry.waiting, paired ? nullptr : view);
  entry.waits_again = false;
  if (paired) replaced = succeed(entry, std::move(view));
  entry.updated = ++updates_;
  evict(key);
}

void ViewStore::set_paired(std::optional<std::vector<PairedVersion>> versions) {
  Views gone;  // freed without the lock
  const std::scoped_lock lock(mutex_);
  paired_ = std::move(versions);
  for (auto& [key, entry] : views_) {
    if (entry.view && !is_paired(*entry.view)) {
      // Its visibility is not here yet, or had to go; nobody sends the picture again when it comes.
      if (!entry.waiting) {
        entry.waiting = std::exchange(entry.view, nullptr);
        entry.waits_again = true;
      }
      replace(entry.view, nullptr);
    }
    if (!entry.waiting || !is_paired(*entry.waiting)) continue;
    const TrainingViewPtr waited = entry.waiting;
    replace(entry.waiting, nullptr);
    std::ranges::move(succeed(entry, waited), std::back_inserter(gone));
  }
}

std::vector<std::uint64_t> ViewStore::versions() const {
  const std::scoped_lock lock(mutex_);
  std::vector<std::uint64_t> all;
  for (const auto& [key, entry] : views_) {
    for (const TrainingViewPtr& view : {entry.view, entry.waiting}) {
      if (view) all.push_back(view->scene.version);
    }
  }
  std::sort(all.begin(), all.end());
  all.erase(std::unique(all.begin(), all.end()), all.end());
  return all;
}

std::uint64_t ViewStore::unpaired() const {
  const std::scoped_lock lock(mutex_);
  return unpaired_;
}

void ViewStore::evict(const ViewKey& newest) {
  while (views_.size() > 1 && (views_.size() > max_views_ || bytes_ > max_bytes_)) {
    auto oldest = views_.end();
    for (auto it = views_.begin(); it != views_.end(); ++it) {
      const bool older = oldest == views_.end() || it->second.updated < oldest->second.updated;
      if (it->first != newest && older) oldest = it;
    }
    drop(oldest->second);
    views_.erase(oldest);
    ++cameras_version_;
  }
}

void ViewStore::drop(Entry& entry) {
  if (entry.waiting && !entry.waits_again) ++unpaired_;
  replace(entry.view, nullptr);
  replace(entry.waiting, nullptr);
}

void ViewStore::retire(const ViewKey& key) {
  const std::scoped_lock lock(mutex_);
  const auto found = views_.find(key);
  if (found == views_.end()) return;
  drop(found->second);
  views_.erase(found);
  ++cameras_version_;
}

TrainingViewPtr ViewStore::find(const ViewKey& key) const {
  const std::scoped_lock lock(mutex_);
  if (key.kept_number != 0) {
    TrainingViewPtr kept = kept_.find(key);
    return kept && is_paired(*kept) ? kept : nullptr;
  }
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

std::vector<ViewKey> ViewStore::kept_keys() const {
  const std::scoped_lock lock(mutex_);
  return kept_.keys(reference_cameras(), kKeptReach_m);
}

std::vector<TrainingViewPtr> ViewStore::kept_about(const TrainingView& view) {
  const std::scoped_lock lock(mutex_);
  return kept_.some_about(view, kKeptReach_m, kKeptAtOnce);
}

void ViewStore::drop_kept(std::span<const std::uint32_t> numbers) {
  Views gone;  // freed without the lock
  const std::scoped_lock lock(mutex_);
  gone = kept_.drop(numbers);
}

bool ViewStore::any_to_train(CameraRole role) const {
  const std::scoped_lock lock(mutex_);
  return std::any_of(views_.begin(), views_.end(),
                     [&](const auto& view) { return view.first.role == role && view.second.view; });
}

std::size_t ViewStore::count(CameraRole role) const {
  const std::scoped_lock lock(mutex_);
  return static_cast<std::size_t>(
      std::count_if(views_.begin(), views_.end(), [&](const auto& view) { return view.first.role == role; }));
}

std::size_t ViewStore::kept() const {
  const std::scoped_lock lock(mutex_);
  return kept_.count();
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
