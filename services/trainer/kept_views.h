#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <span>
#include <vector>

#include "trainer/training_view.h"

namespace splatbus::trainer {

/// Whether two views show the same state of the scene in pictures of one size.
[[nodiscard]] bool same_kind(const TrainingView& a, const TrainingView& b);

/// Pictures that reference cameras had of where they stood before, as far as the scene is still as they show it: what a
/// viewer has walked past goes on being learned (docs/decisions/0134-kept-views.md). All of one scene version and one
/// size; about one for each place and direction. Not thread-safe.
class KeptViews {
 public:
  struct Limits {
    std::size_t views = 512, bytes = std::size_t{512} << 20;
    /// A view nearer than this to one that is kept, and turned less, shows nothing else.
    float apart_m = 1, apart_radians = 0.5F;
  };

  KeptViews() = default;
  explicit KeptViews(const Limits& limits) : limits_(limits) {}

  /// Of the kind of those that are there. Where there is no room for it, the one farthest from it goes.
  void keep(const TrainingView& view);
  /// All go when they are not of the kind of this newer view.
  void see(const TrainingView& newer);
  void clear();
  void drop(std::span<const std::uint32_t> numbers);

  /// Of the views within `reach_m` of one of these cameras, but for those that show what one of them shows.
  [[nodiscard]] std::vector<ViewKey> keys(std::span<const Camera> cameras, float reach_m) const;
  /// At most `most` of those within `reach_m` of a camera, others with each call.
  [[nodiscard]] std::vector<TrainingViewPtr> some_about(const Camera& camera, float reach_m, std::size_t most);
  /// Null when it has gone.
  [[nodiscard]] TrainingViewPtr find(const ViewKey& key) const;
  [[nodiscard]] std::size_t count() const { return views_.size(); }
  [[nodiscard]] std::size_t bytes() const { return bytes_; }

 private:
  [[nodiscard]] bool show_the_same(const Camera& a, const Camera& b) const;
  void make_room(const TrainingView& view);

  Limits limits_;
  std::map<std::uint32_t, TrainingViewPtr> views_;  ///< by number, from 1
  std::uint32_t numbers_ = 0, last_given_ = 0;
  std::size_t bytes_ = 0;
};

}  // namespace splatbus::trainer
