#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <span>
#include <vector>

#include "model/page_store.h"
#include "trainer/gradient_step.h"
#include "trainer/options.h"

namespace splatbus::trainer {

/// Decides which pages rest, by what views show of them and how far their Gaussians move, and says so in the page
/// table (PageEntry::loss, movement, contribution, last_seen_step). docs/decisions/0103-freezing.md. One thread.
class Freezer {
 public:
  /// Takes in what a step saw.
  void see(const model::PageStore& store, std::span<const ViewLook> looks);

  struct Change {
    std::vector<std::uint32_t> freeze, thaw;
  };
  /// Whether decide() has something to look at: once a while.
  [[nodiscard]] bool due(const model::PageStore& store) const { return store.optimizer_s() >= next_s_; }
  /// Pages whose state is to change. `movements`: of each range of the store's view.
  [[nodiscard]] Change decide(const model::PageStore& store, const FreezeOptions& options,
                              std::span<const float> movements);

 private:
  using LightNumbers = std::vector<std::uint64_t>;  ///< ascending
  struct Page {
    std::uint64_t generation = 0;  ///< of its structure, as it was last looked at
    std::uint32_t frame_id = 0;
    std::uint64_t morton_first = 0;
    std::uint32_t count = 0;
    bool frozen = false;
    double since_s = 0, seen_s = 0;  ///< of optimizer time: that the window began; of the last look from near
    /// Sum over the looks of the window from near, and the mean of the one before; below 0: none.
    double loss = 0;
    std::uint32_t looks = 0;
    double loss_before = -1;
    float px_per_m = 0, thawing_px_per_m = 0;  ///< in the nearest view it trained with; in one since it froze
    double loss_at_freeze = 0;                 ///< below 0: nobody knows
    /// Looks from afar: sum since they were last judged, and what their mean has come to; below 0: nobody knows.
    double loss_from_afar = 0;
    std::uint32_t looks_from_afar = 0, unsettled_from_afar = 0;
    double usual_from_afar = -1;
    float afar_px_per_m = 0;        ///< of the nearest of the former
    std::uint32_t times_worse = 0;  ///< in a row
    /// Lights that it was seen under in the window, in the one before, and that it had settled under when it froze.
    LightNumbers lights, lights_before, settled_under;
    std::uint32_t unsettled_looks = 0;  ///< since it froze, under none of the latter
  };
  Page& at(const model::PageStore& store, std::uint32_t page);
  /// Whether a page is to be learned anew from where only views from afar show it: nullopt, or with how many pixels a
  /// metre.
  [[nodiscard]] static std::optional<float> learn_from_afar(Page& page, const FreezeOptions& options);
  /// Number of the scene's light among the last ones that differ; nullopt for one that is older than all of them.
  [[nodiscard]] std::optional<std::uint64_t> number_of(const SceneState& scene);

  std::vector<Page> pages_;
  struct KnownLight {
    std::uint64_t number = 0;
    Light light;  ///< as it was first seen
  };
  std::deque<KnownLight> lights_;  ///< the newest last
  std::uint64_t light_count_ = 0, newest_version_ = 0;
  /// Of optimizer time: when decide() is due, when pages may freeze, and when all began. The latter is rare, for what
  /// reads the model has to look at each page anew that changes its state.
  double next_s_ = 0, next_freeze_s_ = -1, first_seen_s_ = -1;
};

/// How differently two lights show a scene: what changes of the light that arrives, as a share of all. Of a surface
/// that faces what changes; sources count as they would at a metre, one that moved by a metre or more as another.
[[nodiscard]] float light_change(const Light& before, const Light& now);

/// Pixels that a metre takes at the point of a page's bounds that is nearest to the camera; 0 for an object that the
/// view does not have.
[[nodiscard]] float nearest_px_per_m(const TrainingView& view, std::uint32_t frame_id, const PageBounds& bounds);

}  // namespace splatbus::trainer
