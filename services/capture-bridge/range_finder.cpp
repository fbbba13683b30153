#include "capture-bridge/range_finder.h"

#include <algorithm>
#include <limits>
#include <utility>

namespace splatbus::capture_bridge {

namespace {

constexpr double kMaxCredit = 2;
constexpr double kOverdraft = 1;                         // for viewers without a cube of use
constexpr std::int64_t kCubePatienceNs = 3'000'000'000;  // then a cube that has not come is given up
constexpr std::int64_t kOverdraftPatienceNs = 1'000'000'000;
constexpr std::int64_t kRest = 5;  // times as long as a cube took, until the next: the engine has other things to do
constexpr float kNear_m = 0.02F, kFar_m = 200;

}  // namespace

void RangeFinder::update(const RangeOptions& options, const Viewers& viewers, std::int64_t now_ns, CameraSet& cameras) {
  reach_m_ = options.reach_m;
  for (auto& [name, range] : ranges_) {
    const auto viewer = viewers.all().find(name);
    const bool late = range.pending && now_ns - range.pending->asked_ns > kCubePatienceNs;
    if (late) rest_until_ns_ = now_ns + kCubePatienceNs;
    if (late || viewer == viewers.all().end() || (range.pending && range.pending->jumps != viewer->second.jumps)) {
      cancel(range, cameras);
    }
  }
  std::erase_if(ranges_, [&](const auto& entry) { return !viewers.all().contains(entry.first); });
  credit_ = std::min(kMaxCredit, credit_ + options.rate_hz * static_cast<double>(now_ns - credited_ns_) * 1e-9);
  credited_ns_ = now_ns;
  while (options.rate_hz > 0 && credit_ + kOverdraft >= 1) {
    // Whoever has waited longest: one who outruns his cubes starves nobody, nor by always having none.
    const std::pair<const std::string, Viewer>* next = nullptr;
    std::int64_t oldest_ns = 0;
    for (const auto& entry : viewers.all()) {
      const auto known = ranges_.find(entry.first);
      const std::int64_t asked_ns = known == ranges_.end() ? 0 : known->second.asked_ns;
      const bool overdraws = credit_ < 1;
      if (overdraws && asked_ns > 0 && now_ns - asked_ns < kOverdraftPatienceNs) continue;
      const float least_m = overdraws || now_ns < rest_until_ns_ ? options.reach_m : options.move_m;
      if (!(off_cube(entry.first, entry.second) > least_m) || (next != nullptr && asked_ns >= oldest_ns)) continue;
      oldest_ns = asked_ns;
      next = &entry;
    }
    if (next == nullptr) return;
    ask(options, next->second, range_of(next->first), now_ns, cameras);
    credit_ -= 1;
  }
}

float RangeFinder::off_cube(const std::string& name, const Viewer& viewer) const {
  const auto known = ranges_.find(name);
  if (known != ranges_.end() && known->second.pending) return 0;
  const FreeSpace* const free = about(name, viewer.position());
  return free == nullptr ? std::numeric_limits<float>::max() : glm::distance(free->place(), viewer.position());
}

RangeFinder::Range& RangeFinder::range_of(const std::string& viewer) {
  const auto [place, is_new] = ranges_.try_emplace(viewer);
  if (!is_new) return place->second;
  std::uint32_t slot = 0;
  const auto taken = [&](const auto& entry) { return entry.first != viewer && entry.second.slot == slot; };
  while (std::ranges::any_of(ranges_, taken)) ++slot;
  place->second.slot = slot;
  return place->second;
}

void RangeFinder::ask(const RangeOptions& options, const Viewer& viewer, Range& range, std::int64_t now_ns,
                      CameraSet& cameras) {
  Cube cube{.cameras = FreeSpace::cameras(viewer.position(), options.size, kNear_m, kFar_m),
            .depth_m = {},
            .asked_ns = now_ns,
            .jumps = viewer.jumps};
  for (std::size_t face = 0; face < FreeSpace::kFaces; ++face) {
    Camera& camera = cube.cameras.at(face);
    camera.id = kFirstId + range.slot * FreeSpace::kFaces + static_cast<std::uint32_t>(face);
    cube.request_ids.at(face) = cameras.add(camera, wire::EngineBuffer::Depth, 0);
  }
  range.pending = std::move(cube);
  range.asked_ns = now_ns;
}

void RangeFinder::cancel(Range& range, CameraSet& cameras) {
  if (!range.pending) return;
  for (const Camera& camera : range.pending->cameras) cameras.remove(CameraRole::Probe, camera.id);
  range.pending.reset();
}

const Camera* RangeFinder::awaited(std::uint32_t camera_id, std::uint64_t request_id) const {
  const std::uint32_t slot = (camera_id - kFirstId) / FreeSpace::kFaces;
  const std::size_t face = (camera_id - kFirstId) % FreeSpace::kFaces;
  const auto found = std::ranges::find_if(ranges_, [&](const auto& entry) {
    const Range& range = entry.second;
    return range.slot == slot && range.pending && range.pending->request_ids.at(face) == request_id;
  });
  return found == ranges_.end() ? nullptr : &found->second.pending->cameras.at(face);
}

void RangeFinder::take(std::uint32_t camera_id, std::vector<float> depth_m, std::int64_t now_ns, CameraSet& cameras) {
  const std::uint32_t slot = (camera_id - kFirstId) / FreeSpace::kFaces;
  const auto found = std::ranges::find_if(ranges_, [&](const auto& entry) { return entry.second.slot == slot; });
  if (found == ranges_.end() || !found->second.pending) return;
  Range& range = found->second;
  range.pending->depth_m.at((camera_id - kFirstId) % FreeSpace::kFaces) = std::move(depth_m);
  if (std::ranges::any_of(range.pending->depth_m, [](const auto& face) { return face.empty(); })) return;
  range.free.emplace(range.pending->cameras, std::move(range.pending->depth_m));
  rest_until_ns_ = now_ns + kRest * (now_ns - range.pending->asked_ns);
  cancel(range, cameras);
}

const FreeSpace* RangeFinder::about(const std::string& viewer, const glm::vec3& position) const {
  const auto found = ranges_.find(viewer);
  if (found == ranges_.end() || !found->second.free) return nullptr;
  const FreeSpace& free = *found->second.free;
  return glm::distance(free.place(), position) <= reach_m_ && free.sees(position) ? &free : nullptr;
}

}  // namespace splatbus::capture_bridge
