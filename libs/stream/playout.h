#pragma once

#include <cstdint>
#include <deque>
#include <memory>

#include "gaussians/light.h"

namespace splatbus::stream {

/// `part` of the way from one scene to the other, beyond 1 on along the same way: objects that both have, and below 1
/// the light. What only one of the two has is as in `to`; the version is that of the nearer one.
[[nodiscard]] SceneState scene_between(const SceneState& from, const SceneState& to, double part);

/// Scenes where they were a little while ago, between the states that say so, at any time of the viewer's clock. The
/// engine's clock is brought to it by the state that came fastest of the last ones; the delay is as long as the others
/// were later and a state lasts. What is shown never runs backwards: it goes slower while the delay grows, and a little
/// faster while it shrinks. One thread.
class Playout {
 public:
  /// Beyond the last state things go on as they went for as long, then rest.
  static constexpr std::int64_t kBeyond_ns = 100'000'000;
  static constexpr std::int64_t kMaxDelay_ns = 200'000'000;

  /// `capture_ns` by the engine's clock, 0 where nobody knows; `arrived_ns` by the viewer's. Not null.
  void add(std::shared_ptr<const SceneState> scene, std::int64_t capture_ns, std::int64_t arrived_ns);

  /// Goes on to `now_ns` of the viewer's clock.
  void advance(std::int64_t now_ns);
  /// What is to be seen now, by the engine's clock; 0 where nobody knows.
  [[nodiscard]] std::int64_t shown_ns() const { return kept_.empty() ? 0 : shown_ns_; }
  /// The scene then; null before the first.
  [[nodiscard]] std::shared_ptr<const SceneState> scene() const;
  /// Whether it may be another soon, though no state arrives.
  [[nodiscard]] bool moving() const;
  [[nodiscard]] std::int64_t delay_ns() const { return delay_ns_; }

 private:
  struct Kept {
    std::int64_t capture_ns;
    std::shared_ptr<const SceneState> scene;
    bool moved;
  };
  void restart();
  [[nodiscard]] std::int64_t offset_ns() const;
  /// Beyond it nothing is known of how things go on.
  [[nodiscard]] std::int64_t end_ns() const;

  std::deque<Kept> kept_;                      ///< by capture_ns
  std::deque<std::int64_t> offsets_ns_;        ///< the engine's clock less the viewer's, as each state came
  std::shared_ptr<const SceneState> untimed_;  ///< of which nobody knows when it was
  std::int64_t delay_ns_ = 0, shown_ns_ = 0, now_ns_ = 0;
  bool begun_ = false;
};

}  // namespace splatbus::stream
