#include "viewer/picture_age.h"

#include <algorithm>
#include <utility>

namespace splatbus::viewer {
namespace {

constexpr std::size_t kMostAwaited = 4096, kVersions = 64;

double ms_between(std::int64_t begin_ns, std::int64_t end_ns) {
  return static_cast<double>(end_ns - begin_ns) / 1e6;
}

}  // namespace

void PictureAges::came(const SceneState& scene, std::int64_t capture_ns) {
  std::set<std::uint32_t> objects;
  for (const auto& [id, transform] : scene.objects) objects.insert(objects.end(), id);
  if (capture_ns > 0) {
    if (!captured_ns_.empty() && scene.version < captured_ns_.rbegin()->first) captured_ns_.clear();  // another stream
    captured_ns_.emplace(scene.version, capture_ns);
    if (captured_ns_.size() > kVersions) captured_ns_.erase(captured_ns_.begin());
  }
  const auto await = [&](std::uint32_t id, bool exists) {
    awaited_.erase(id);  // whatever was awaited of it before is overtaken
    // Before there is a picture all are late.
    if (capture_ns > 0 && drawn_ && awaited_.size() < kMostAwaited) awaited_[id] = {exists, capture_ns};
  };
  if (std::exchange(begun_, true)) {
    for (const std::uint32_t id : objects_) {
      if (!objects.contains(id)) await(id, false);
    }
    for (const std::uint32_t id : objects) {
      if (!objects_.contains(id)) await(id, true);
    }
  }
  objects_ = std::move(objects);
}

void PictureAges::drawn(const SceneState& scene, const Picture& picture) {
  if (picture.shown_ns > 0) ages_.add(ms_between(picture.shown_ns, picture.finished_ns));
  drawn_ = true;
  std::erase_if(awaited_, [&](const auto& awaited) {
    const auto& [id, change] = awaited;
    if (scene.objects.contains(id) != change.exists) return false;
    object_changes_.add(ms_between(change.capture_ns, picture.finished_ns));
    return true;
  });
  if (std::exchange(visibility_version_, picture.visibility_version) == picture.visibility_version) return;
  const std::int64_t captured = captured_ns(picture.visibility_version);
  if (captured > 0 && picture.shown_ns > 0) visibility_leads_.add(ms_between(picture.shown_ns, captured));
}

}  // namespace splatbus::viewer
