#include "stream/playout.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>

namespace splatbus::stream {
namespace {

constexpr std::size_t kKept = 16;                // states
constexpr std::size_t kOffsets = 64;             // of the clocks
constexpr std::int64_t kGap_ns = 250'000'000;    // states further apart are not of one motion
constexpr double kShrink = 0.02;                 // of what is too much of the delay, a state
constexpr double kSlower = 0.5, kFaster = 0.02;  // of the clock's own speed

glm::vec3 direction_between(const glm::vec3& from, const glm::vec3& to, float part) {
  const glm::vec3 sum = glm::mix(from, to, part);
  const float length = glm::length(sum);
  return length > 1e-3F ? sum / length : to;
}

void mix_light(const Light& from, float part, Light& to) {
  for (std::size_t k = 0; k < to.ambient_sh.size(); ++k) {
    to.ambient_sh[k] = glm::mix(from.ambient_sh[k], to.ambient_sh[k], part);
  }
  to.sun_direction = direction_between(from.sun_direction, to.sun_direction, part);
  to.sun_irradiance = glm::mix(from.sun_irradiance, to.sun_irradiance, part);
  to.background = glm::mix(from.background, to.background, part);
  for (LightSource& source : to.sources) {
    const auto before = std::find_if(from.sources.begin(), from.sources.end(),
                                     [&](const LightSource& other) { return other.id == source.id; });
    if (before == from.sources.end() || before->kind != source.kind) continue;
    source.position = glm::mix(before->position, source.position, part);
    source.direction = direction_between(before->direction, source.direction, part);
    source.intensity = glm::mix(before->intensity, source.intensity, part);
  }
}

}  // namespace

SceneState scene_between(const SceneState& from, const SceneState& to, double part) {
  SceneState out = to;
  if (part < 0.5) out.version = from.version;
  const auto along = static_cast<float>(part);
  if (along < 1) mix_light(from.light, along, out.light);
  for (auto& [id, object] : out.objects) {
    const auto before = from.objects.find(id);
    if (before == from.objects.end()) continue;
    object.rigid.translation = glm::mix(before->second.rigid.translation, object.rigid.translation, along);
    object.rigid.rotation = glm::normalize(glm::slerp(before->second.rigid.rotation, object.rigid.rotation, along));
    object.scale = std::max(glm::mix(before->second.scale, object.scale, along), 0.5F * object.scale);
  }
  return out;
}

void Playout::restart() {
  kept_.clear();
  offsets_ns_.clear();
  delay_ns_ = 0;
  begun_ = false;
}

std::int64_t Playout::offset_ns() const {
  return *std::max_element(offsets_ns_.begin(), offsets_ns_.end());
}

void Playout::add(std::shared_ptr<const SceneState> scene, std::int64_t capture_ns, std::int64_t arrived_ns) {
  untimed_ = nullptr;
  if (capture_ns <= 0) {
    restart();
    untimed_ = std::move(scene);
    return;
  }
  if (!kept_.empty() && capture_ns < kept_.back().capture_ns) restart();  // another engine, of another clock
  if (!kept_.empty() && capture_ns == kept_.back().capture_ns) {
    kept_.back().scene = std::move(scene);  // what is another than its objects
    return;
  }
  offsets_ns_.push_back(capture_ns - arrived_ns);
  if (offsets_ns_.size() > kOffsets) offsets_ns_.pop_front();
  std::int64_t late_ns = 0;
  const std::int64_t offset = offset_ns();
  for (std::size_t k = offsets_ns_.size() - std::min(kKept, offsets_ns_.size()); k < offsets_ns_.size(); ++k) {
    late_ns = std::max(late_ns, offset - offsets_ns_[k]);
  }
  const std::int64_t apart_ns = kept_.empty() ? 0 : capture_ns - kept_.back().capture_ns;
  const std::int64_t lasts_ns = apart_ns < kGap_ns ? apart_ns : 0;
  const std::int64_t needed_ns = std::min(late_ns + lasts_ns, kMaxDelay_ns);
  const auto shrunk_ns = delay_ns_ + static_cast<std::int64_t>(kShrink * static_cast<double>(needed_ns - delay_ns_));
  delay_ns_ = std::max(needed_ns, shrunk_ns);
  const bool moved =
      !kept_.empty() && (scene->objects != kept_.back().scene->objects || scene->light != kept_.back().scene->light);
  kept_.push_back({capture_ns, std::move(scene), moved});
  if (kept_.size() > kKept) kept_.pop_front();
}

std::int64_t Playout::end_ns() const {
  return kept_.back().capture_ns + (kept_.size() > 1 ? kBeyond_ns : 0);
}

void Playout::advance(std::int64_t now_ns) {
  if (kept_.empty()) return;
  const std::int64_t wanted_ns = std::min(now_ns + offset_ns() - delay_ns_, end_ns());
  const auto step_ns = static_cast<double>(std::max<std::int64_t>(now_ns - now_ns_, 0));
  now_ns_ = now_ns;
  if (!begun_ || std::abs(wanted_ns - shown_ns_) > kGap_ns) {
    begun_ = true;
    shown_ns_ = wanted_ns;
    return;
  }
  const auto slowest = static_cast<std::int64_t>((1 - kSlower) * step_ns);
  const auto fastest = static_cast<std::int64_t>((1 + kFaster) * step_ns);
  shown_ns_ = std::max(shown_ns_, std::min(shown_ns_ + std::clamp(wanted_ns - shown_ns_, slowest, fastest), end_ns()));
}

std::shared_ptr<const SceneState> Playout::scene() const {
  if (kept_.empty()) return untimed_;
  const std::int64_t shown_ns = std::min(shown_ns_, end_ns());
  auto next = std::find_if(kept_.begin(), kept_.end(), [&](const Kept& kept) { return kept.capture_ns >= shown_ns; });
  if (next == kept_.begin()) return next->scene;
  if (next == kept_.end()) --next;  // beyond the last: as between the two before
  if (next == kept_.begin()) return next->scene;
  const Kept &from = *(next - 1), &to = *next;
  const std::int64_t apart_ns = to.capture_ns - from.capture_ns;
  if (apart_ns > kGap_ns) return shown_ns >= to.capture_ns ? to.scene : from.scene;
  const double part = static_cast<double>(shown_ns - from.capture_ns) / static_cast<double>(apart_ns);
  if (part == 1 || !to.moved) return to.scene;
  return std::make_shared<const SceneState>(scene_between(*from.scene, *to.scene, part));
}

bool Playout::moving() const {
  return !kept_.empty() && kept_.back().moved && shown_ns_ < end_ns();
}

}  // namespace splatbus::stream
