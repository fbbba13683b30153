#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <random>
#include <vector>

#include "trainer/view_store.h"

namespace splatbus::trainer {

/// Batches of what reference cameras see now between two of another kind; 0: none of that kind.
struct ViewIntervals {
  int input = 0, kept = 0;
};

/// Which views are trained when: epochs over the reference cameras, each in an order of its own, from which those are
/// left out now and then that have less to teach than the mean, down to every fourth time; after every so many of them
/// one input camera (docs/decisions/0073-training-defaults.md), and one view that is kept of a place nearby, or
/// more seldom where what is seen now has more to teach (0134-kept-views.md). Without reference cameras, input cameras
/// only. A batch of several views is of one kind, for pictures of one size are trained at once; intervals then are
/// batches. The same seed, cameras and calls give the same choice.
class ViewSampler {
 public:
  explicit ViewSampler(std::uint64_t seed);

  /// What a view has to teach: its loss, and more of it where more of what shows trains. Forgotten with `forget()`.
  /// Without `active_share` it stays as it was.
  void learn(const ViewKey& key, float loss, std::optional<float> active_share);
  /// All views are worth the same from now on.
  void forget() { views_.clear(); }

  /// The next views, at most `size`; none when there are none.
  [[nodiscard]] std::vector<TrainingViewPtr> next_batch(const ViewStore& views, int size, ViewIntervals intervals);
  /// A batch of one; null when there is none.
  [[nodiscard]] TrainingViewPtr next(const ViewStore& views, ViewIntervals intervals);

 private:
  enum class Kind : std::uint8_t { Reference, Input, Kept };
  struct Epoch {
    Kind kind;
    std::vector<ViewKey> left{};
    float to_teach = 0;  ///< mean of its views; 0: nobody knows
  };
  static std::vector<ViewKey> keys(const ViewStore& views, Kind kind);
  TrainingViewPtr draw(const ViewStore& views, Epoch& epoch);
  std::vector<TrainingViewPtr> draw_batch(const ViewStore& views, int size, Epoch& epoch);

  struct Worth {
    float to_teach = 0, active_share = 1;
    float turns = 0;  ///< that it is owed, below 1
  };
  void leave_out(Epoch& epoch);
  /// Of kept views those that are not among these, which ascend.
  void forget_but(const std::vector<ViewKey>& kept);
  /// Turns of kept views that a reference view's is worth.
  [[nodiscard]] float kept_turns(int interval) const;

  std::map<ViewKey, Worth> views_;
  std::mt19937_64 random_;
  Epoch references_{.kind = Kind::Reference};
  Epoch inputs_{.kind = Kind::Input};
  Epoch kept_{.kind = Kind::Kept};
  int references_since_input_ = 0;
  float kept_owed_ = 0;  ///< turns
};

}  // namespace splatbus::trainer
