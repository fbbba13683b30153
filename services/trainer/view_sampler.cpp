#include "trainer/view_sampler.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace splatbus::trainer {

namespace {

/// Fisher-Yates with the engine's own numbers: std::shuffle differs between standard libraries.
void shuffle(std::vector<ViewKey>& keys, std::mt19937_64& random) {
  for (std::size_t i = keys.size(); i > 1; --i) std::swap(keys[i - 1], keys[random() % i]);
}

/// Part of the turns that a view gets at least.
constexpr float kLeastTurns = 0.25F;
/// What a view is worth where nothing of it trains, of what it would be: its loss may rise.
constexpr float kRestingWorth = 0.05F;
/// Kept views of an epoch.
constexpr std::size_t kMostKept = 64;

}  // namespace

ViewSampler::ViewSampler(std::uint64_t seed) : random_(seed) {}

void ViewSampler::learn(const ViewKey& key, float loss, std::optional<float> active_share) {
  if (!std::isfinite(loss)) return;
  if (views_.size() >= ViewStore::kMaxViews && !views_.contains(key)) views_.clear();
  Worth& worth = views_[key];
  worth.active_share = active_share.value_or(worth.active_share);
  worth.to_teach = loss * (kRestingWorth + (1 - kRestingWorth) * worth.active_share);
}

void ViewSampler::forget_but(const std::vector<ViewKey>& kept) {
  std::erase_if(views_, [&](const auto& known) {
    return known.first.kept_number != 0 && !std::ranges::binary_search(kept, known.first);
  });
}

void ViewSampler::leave_out(Epoch& epoch) {
  std::vector<ViewKey>& keys = epoch.left;
  epoch.to_teach = 0;
  double sum = 0;
  std::size_t known = 0;
  for (const ViewKey& key : keys) {
    const auto found = views_.find(key);
    if (found == views_.end()) continue;
    sum += found->second.to_teach;
    ++known;
  }
  if (known == 0) return;
  const auto mean = static_cast<float>(sum / static_cast<double>(known));
  epoch.to_teach = mean;
  std::erase_if(keys, [&](const ViewKey& key) {
    const auto found = views_.find(key);
    if (found == views_.end()) return false;
    Worth& worth = found->second;
    worth.turns += mean > 0 ? std::clamp(worth.to_teach / mean, kLeastTurns, 1.0F) : 1.0F;
    if (worth.turns < 1) return true;
    worth.turns -= 1;
    return false;
  });
}

std::vector<ViewKey> ViewSampler::keys(const ViewStore& views, Kind kind) {
  if (kind == Kind::Kept) return views.kept_keys();
  return views.keys(kind == Kind::Input ? CameraRole::Input : CameraRole::Reference);
}

TrainingViewPtr ViewSampler::draw(const ViewStore& views, Epoch& epoch) {
  for (int refills = 0;; ++refills) {
    while (!epoch.left.empty()) {
      const ViewKey key = epoch.left.back();
      epoch.left.pop_back();
      auto view = views.find(key);
      if (view) return view;
    }
    if (refills == 2) return nullptr;
    epoch.left = keys(views, epoch.kind);
    if (epoch.kind == Kind::Kept) forget_but(epoch.left);
    shuffle(epoch.left, random_);
    // Whoever looks may have gone elsewhere before all have had their turn.
    if (epoch.kind == Kind::Kept) epoch.left.resize(std::min(epoch.left.size(), kMostKept));
    if (refills == 0) leave_out(epoch);  // those that are left may have nothing to train on
  }
}

std::vector<TrainingViewPtr> ViewSampler::draw_batch(const ViewStore& views, int size, Epoch& epoch) {
  std::vector<TrainingViewPtr> batch;
  while (static_cast<int>(batch.size()) < size) {
    auto view = draw(views, epoch);
    if (!view) break;
    batch.push_back(std::move(view));
  }
  return batch;
}

float ViewSampler::kept_turns(int interval) const {
  if (interval <= 0) return 0;
  const bool known = kept_.to_teach > 0 && references_.to_teach > 0;
  const float worth = known ? std::clamp(kept_.to_teach / references_.to_teach, kLeastTurns, 1.0F) : 1.0F;
  return worth / static_cast<float>(interval);
}

std::vector<TrainingViewPtr> ViewSampler::next_batch(const ViewStore& views, int size, ViewIntervals intervals) {
  if (kept_owed_ >= 1) {
    kept_owed_ -= 1;
    if (auto batch = draw_batch(views, size, kept_); !batch.empty()) return batch;
  }
  const bool input_is_due = intervals.input > 0 && references_since_input_ >= intervals.input;
  if (!input_is_due) {
    if (auto batch = draw_batch(views, size, references_); !batch.empty()) {
      ++references_since_input_;
      kept_owed_ += kept_turns(intervals.kept);
      return batch;
    }
  }
  references_since_input_ = 0;
  if (intervals.input > 0) {
    if (auto batch = draw_batch(views, size, inputs_); !batch.empty()) return batch;
  }
  return draw_batch(views, size, references_);
}

TrainingViewPtr ViewSampler::next(const ViewStore& views, ViewIntervals intervals) {
  auto batch = next_batch(views, 1, intervals);
  return batch.empty() ? nullptr : std::move(batch.front());
}

}  // namespace splatbus::trainer
