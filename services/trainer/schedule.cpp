#include "trainer/schedule.h"

#include <utility>

namespace splatbus::trainer {

namespace {

/// Fisher-Yates with the engine's own numbers: std::shuffle differs between standard libraries.
void shuffle(std::vector<ViewKey>& keys, std::mt19937_64& random) {
  for (std::size_t i = keys.size(); i > 1; --i) std::swap(keys[i - 1], keys[random() % i]);
}

}  // namespace

Schedule::Schedule(std::uint64_t seed) : random_(seed) {}

TrainingViewPtr Schedule::draw(const ViewStore& views, Epoch& epoch, std::optional<std::uint64_t> light) {
  for (bool refilled = false;;) {
    while (!epoch.left.empty()) {
      const ViewKey key = epoch.left.back();
      epoch.left.pop_back();
      auto view = views.find(key);
      if (view && (!light || view->scene.light.generation == *light)) return view;
    }
    if (refilled) return nullptr;
    epoch.left = views.keys(epoch.role);
    shuffle(epoch.left, random_);
    refilled = true;
  }
}

TrainingViewPtr Schedule::next(const ViewStore& views, int input_interval) {
  const bool input_is_due = input_interval > 0 && references_since_input_ >= input_interval;
  if (!input_is_due) {
    if (auto view = draw(views, references_)) {
      ++references_since_input_;
      return view;
    }
  }
  references_since_input_ = 0;
  if (input_interval > 0) {
    if (auto view = draw(views, inputs_, views.reference_light())) return view;
  }
  return draw(views, references_);
}

}  // namespace splatbus::trainer
