#include "trainer/view_sampler.h"

#include <utility>

namespace splatbus::trainer {

namespace {

/// Fisher-Yates with the engine's own numbers: std::shuffle differs between standard libraries.
void shuffle(std::vector<ViewKey>& keys, std::mt19937_64& random) {
  for (std::size_t i = keys.size(); i > 1; --i) std::swap(keys[i - 1], keys[random() % i]);
}

}  // namespace

ViewSampler::ViewSampler(std::uint64_t seed) : random_(seed) {}

TrainingViewPtr ViewSampler::draw(const ViewStore& views, Epoch& epoch) {
  for (bool refilled = false;;) {
    while (!epoch.left.empty()) {
      const ViewKey key = epoch.left.back();
      epoch.left.pop_back();
      auto view = views.find(key);
      if (view) return view;
    }
    if (refilled) return nullptr;
    epoch.left = views.keys(epoch.role);
    shuffle(epoch.left, random_);
    refilled = true;
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

std::vector<TrainingViewPtr> ViewSampler::next_batch(const ViewStore& views, int size, int input_interval) {
  const bool input_is_due = input_interval > 0 && references_since_input_ >= input_interval;
  if (!input_is_due) {
    if (auto batch = draw_batch(views, size, references_); !batch.empty()) {
      ++references_since_input_;
      return batch;
    }
  }
  references_since_input_ = 0;
  if (input_interval > 0) {
    if (auto batch = draw_batch(views, size, inputs_); !batch.empty()) return batch;
  }
  return draw_batch(views, size, references_);
}

TrainingViewPtr ViewSampler::next(const ViewStore& views, int input_interval) {
  auto batch = next_batch(views, 1, input_interval);
  return batch.empty() ? nullptr : std::move(batch.front());
}

}  // namespace splatbus::trainer
