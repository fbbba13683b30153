#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <map>
#include <span>
#include <vector>

#include "trainer/training_view.h"

namespace splatbus::trainer {

/// Pictures that reference cameras had of where they stood before, as far as the scene is still as they show it: what a
/// viewer has walked past goes on being learned (docs/decisions/0134-kept-views.md). All of one scene version; about
/// one for each place and direction. Not thread-safe. What goes is handed back, so that its memory is not freed under
/// the owner's lock.
class KeptViews {
 public:
  struct Limits {
    std::size_t views = 2048, bytes = std::size_t{2} << 30;
    /// A view nearer than this to one that is kept, turned less and as wide, shows nothing else.
    float apart_m = 1, apart_radians = 0.5F, apart_zoom = 1.25F;
    /// Then it takes the other's place: what has changed in colour alone is nobody's version.
    std::chrono::seconds lasts{30};
  };

  KeptViews() = default;
  explicit KeptViews(const Limits& limits) : limits_(limits) {}

  /// A view of their scene version, with depth. Where there is no room for it, the one farthest from all of `cameras`
  /// goes.
  [[nodiscard]] std::vector<TrainingViewPtr> keep(const TrainingView& view, std::span<const Camera> cameras);
  /// All go when they are of an older scene version.
  [[nodiscard]] std::vector<TrainingViewPtr> see(std::uint64_t scene_version);
  [[nodiscard]] std::vector<TrainingViewPtr> clear();
  [[nodiscard]] std::vector<TrainingViewPtr> drop(std::span<const std::uint32_t> numbers);

  /// Of the views within `reach_m` of one of these cameras, but for those that show what one of them shows.
  [[nodiscard]] std::vector<ViewKey> keys(std::span<const Camera> cameras, float reach_m) const;
  /// At most `most` of those within `reach_m` of a view of their scene version: those that were asked for longest ago.
  [[nodiscard]] std::vector<TrainingViewPtr> some_about(const TrainingView& view, float reach_m, std::size_t most);
  /// Null when it has gone.
  [[nodiscard]] TrainingViewPtr find(const ViewKey& key) const;
  [[nodiscard]] std::size_t count() const { return views_.size(); }
  [[nodiscard]] std::size_t bytes() const { return bytes_; }

 private:
  using Clock = std::chrono::steady_clock;
  struct Kept {
    TrainingViewPtr view;
    Clock::time_point since{};
    std::uint64_t asked = 0;  ///< number of the last some_about() that gave it
  };
  using Views = std::map<std::uint32_t, Kept>;  ///< by number, from 1

  [[nodiscard]] bool show_the_same(const Camera& a, const Camera& b) const;
  Views::iterator farthest(std::span<const Camera> cameras);
  Views::iterator take_out(Views::iterator at, std::vector<TrainingViewPtr>& gone);

  Limits limits_;
  Views views_;
  std::uint32_t numbers_ = 0;
  std::uint64_t scene_version_ = 0, asked_ = 0;
  std::size_t bytes_ = 0;
};

}  // namespace splatbus::trainer
