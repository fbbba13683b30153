#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <random>
#include <vector>

#include "trainer/view_store.h"

namespace splatbus::trainer {

/// Which views are trained when: epochs over the reference cameras, each in an order of its own, from which those are
/// left out now and then that have less to teach than the mean, down to every fourth time; and one input camera after
/// every `input_interval` reference views (docs/decisions/0073-training-defaults.md). Without reference
/// cameras, input cameras only. A batch of several views is of one kind, for pictures of one size are trained at once;
/// one of input cameras then comes after every `input_interval` batches of reference views. The same seed, cameras and
/// calls give the same choice.
class ViewSampler {
 public:
  explicit ViewSampler(std::uint64_t seed);

  /// What a view has to teach: its loss, and more of it where more of what shows trains. Forgotten with `forget()`.
  /// Without `active_share` it stays as it was.
  void learn(const ViewKey& key, float loss, std::optional<float> active_share);
  /// All views are worth the same from now on.
  void forget() { views_.clear(); }

  /// The next views, at most `size`; none when there are none. `input_interval` 0: no input cameras.
  [[nodiscard]] std::vector<TrainingViewPtr> next_batch(const ViewStore& views, int size, int input_interval);
  /// A batch of one; null when there is none.
  [[nodiscard]] TrainingViewPtr next(const ViewStore& views, int input_interval);

 private:
  struct Epoch {
    CameraRole role;
    std::vector<ViewKey> left;
  };
  TrainingViewPtr draw(const ViewStore& views, Epoch& epoch);
  std::vector<TrainingViewPtr> draw_batch(const ViewStore& views, int size, Epoch& epoch);

  struct Worth {
    float to_teach = 0, active_share = 1;
    float turns = 0;  ///< that it is owed, below 1
  };
  void leave_out(std::vector<ViewKey>& keys);

  std::map<ViewKey, Worth> views_;
  std::mt19937_64 random_;
  Epoch references_{.role = CameraRole::Reference, .left = {}};
  Epoch inputs_{.role = CameraRole::Input, .left = {}};
  int references_since_input_ = 0;
};

}  // namespace splatbus::trainer
