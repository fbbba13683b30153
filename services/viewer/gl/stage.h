#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "gaussians/light.h"
#include "viewer/gl/batch.h"
#include "viewer/gl/color_playout.h"
#include "viewer/gl/splat_renderer.h"

namespace splatbus::viewer::gl {

/// Where the objects of a scene are, by the index that records have, for an eye in the origin; all zero where one is
/// not there.
[[nodiscard]] std::vector<Transform> transforms_of(const SceneState& scene,
                                                   const std::vector<std::uint32_t>& object_ids);

/// A picture of rows that change. Of the thread whose context is current.
class Stage {
 public:
  explicit Stage(Draw draw = Draw::Auto) : renderer_(draw) {}

  void add(const Batch& batch);
  /// Colors are those of this time of the engine's clock, between those that came for it; 0, as before the first call:
  /// the newest.
  void advance(std::int64_t shown_ns);
  /// Whether other colors are on their way.
  [[nodiscard]] bool recoloring() const { return colors_.moving(); }

  /// `time_s` as Frame's.
  void draw(const Camera& camera, const SceneState& scene, float time_s, GLuint framebuffer = 0);
  [[nodiscard]] Picture capture(const Camera& camera, const SceneState& scene, float time_s);

  void set_antialias(bool antialias) { antialias_ = antialias; }
  /// Of draw(), as Frame's.
  void set_resolution(float resolution) { resolution_ = resolution; }
  void set_timed(bool timed) { renderer_.set_timed(timed); }
  [[nodiscard]] std::vector<StepTimes> take_times() { return renderer_.take_times(); }
  /// How pictures were drawn. Waits for the device.
  [[nodiscard]] const Drawn& drawn() { return renderer_.drawn(); }
  [[nodiscard]] const DrawChoice& choice() const { return renderer_.choice(); }
  /// Rows that the last picture shows. Waits for the device.
  [[nodiscard]] std::size_t count_seen() const { return renderer_.count_seen(); }
  [[nodiscard]] const std::optional<Bounds>& bounds() const { return bounds_; }
  [[nodiscard]] const RowStore::Uploaded& uploaded() { return renderer_.rows().uploaded(); }

 private:
  [[nodiscard]] Frame frame_of(const Camera& camera, const SceneState& scene, float time_s) const;

  SplatRenderer renderer_;
  ColorPlayout colors_;
  std::int64_t shown_ns_ = 0;
  std::vector<std::uint32_t> object_ids_{kWorldFrame};
  std::optional<Bounds> bounds_;
  bool display_space_ = false, antialias_ = true;
  float resolution_ = 1;
};

}  // namespace splatbus::viewer::gl
