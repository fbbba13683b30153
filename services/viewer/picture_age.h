#pragma once

#include <cstddef>
#include <cstdint>
#include <iterator>
#include <map>
#include <set>

#include "gaussians/light.h"
#include "stream/scene_delay.h"

namespace splatbus::viewer {

/// How long what pictures show takes from the engine's frame until a picture with it is finished. Means something on
/// the engine's machine only, with CLOCK_MONOTONIC as clock. One thread.
class PictureAges {
 public:
  /// A state of the scene has arrived, by ascending time; `capture_ns` is 0 where nobody knows when it was.
  void came(const SceneState& scene, std::int64_t capture_ns);

  /// When the scene of this version was, or the last before it that came here, by the engine's clock; 0: nobody knows.
  [[nodiscard]] std::int64_t captured_ns(std::uint64_t scene_version) const {
    const auto later = captured_ns_.upper_bound(scene_version);
    return later != captured_ns_.begin() ? std::prev(later)->second : 0;
  }

  struct Picture {
    std::int64_t shown_ns = 0;     ///< instant of the scene that is drawn, by the engine's clock; 0: nobody knows
    std::int64_t finished_ns = 0;  ///< by the viewer's
    std::uint64_t visibility_version = 0;  ///< scene version of the newest visibility that is drawn
  };
  void drawn(const SceneState& scene, const Picture& picture);

  /// Of pictures.
  [[nodiscard]] const stream::SceneDelays& ages() const { return ages_; }
  /// From the first state without an object that there was, or with one that there was not, to the first picture so.
  [[nodiscard]] const stream::SceneDelays& object_changes() const { return object_changes_; }
  /// By how much visibility is ahead of the scene that it is drawn with, in the first picture with it.
  [[nodiscard]] const stream::SceneDelays& visibility_leads() const { return visibility_leads_; }

 private:
  struct Awaited {
    bool exists = false;
    std::int64_t capture_ns = 0;
  };
  std::set<std::uint32_t> objects_;  ///< of the state that came last
  bool begun_ = false, drawn_ = false;
  std::map<std::uint32_t, Awaited> awaited_;           ///< by object
  std::map<std::uint64_t, std::int64_t> captured_ns_;  ///< by scene version, of the last ones
  std::uint64_t visibility_version_ = 0;
  stream::SceneDelays ages_, object_changes_, visibility_leads_;
};

}  // namespace splatbus::viewer
