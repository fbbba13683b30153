#pragma once

#include <deque>

#include "gaussians/light.h"
#include "viewer/gl/batch.h"
#include "viewer/gl/sort_thread.h"
#include "viewer/gl/splat_renderer.h"

namespace splatbus::viewer::gl {

/// Where the objects of a scene are, by the index that records have, for an eye in the origin; all zero where one is
/// not there.
[[nodiscard]] std::vector<Transform> transforms_of(const SceneState& scene,
                                                   const std::vector<std::uint32_t>& object_ids);

/// A picture of rows that change: what is sorted and what is drawn are swapped at once, so that nothing flickers. Of
/// the thread whose context is current.
class Stage {
 public:
  void add(SharedBatch batch);
  /// Sorts for that view from now on, and shows what has been sorted meanwhile. True if that was anything.
  bool prepare(const Camera& camera, const SceneState& scene);
  /// The same, and waits until all that was added is sorted for it.
  void settle(const Camera& camera, const SceneState& scene);

  /// Of what prepare() has shown; `time_s` as Frame's.
  void draw(const Camera& camera, const SceneState& scene, float time_s, GLuint framebuffer = 0);
  [[nodiscard]] Picture capture(const Camera& camera, const SceneState& scene, float time_s);

  void set_antialias(bool antialias) { antialias_ = antialias; }
  /// Whether what is shown is not sorted for what was prepared last.
  [[nodiscard]] bool behind() const { return !waiting_.empty() || sorted_.views < looks_; }
  /// Rows that are drawn.
  [[nodiscard]] std::size_t count() const { return renderer_.count(); }
  [[nodiscard]] const std::optional<Bounds>& bounds() const { return bounds_; }
  [[nodiscard]] double sort_ms() const { return sorted_.sort_ms; }
  [[nodiscard]] const RowStore::Uploaded& uploaded() { return renderer_.rows().uploaded(); }

 private:
  [[nodiscard]] Frame frame_of(const Camera& camera, const SceneState& scene, float time_s) const;
  void look(const Camera& camera, const SceneState& scene);
  bool swap();
  [[nodiscard]] std::uint32_t far_field_of(const std::vector<std::uint32_t>& object_ids) const;

  SplatRenderer renderer_;
  SortThread sorter_;
  SortThread::Sorted sorted_;
  std::deque<SharedBatch> waiting_;
  SortView view_;
  std::uint64_t applied_ = 0, looks_ = 0;
  std::vector<std::uint32_t> object_ids_{kWorldFrame}, newest_object_ids_{kWorldFrame};
  std::optional<Bounds> bounds_;
  bool display_space_ = false, antialias_ = true;
};

}  // namespace splatbus::viewer::gl
