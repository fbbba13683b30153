#pragma once

#include <cstddef>
#include <vector>

#include "gl/objects.h"
#include "viewer/gl/frame.h"
#include "viewer/gl/frame_timer.h"
#include "viewer/gl/radix_sort.h"
#include "viewer/gl/row_store.h"

namespace splatbus::viewer::gl {

/// Projects each row once, drops what cannot be seen, and sorts the rest by depth, all on the device: nothing comes
/// back and nothing is kept from picture to picture. Of the context that was current when it was made.
class Projection {
 public:
  Projection();

  void run(const RowStore& rows, const Frame& frame, FrameTimer& timer);
  /// For the program that draws what was seen: Seen, its order, far to near, and what was made of each row.
  void bind() const;
  /// A Seen.
  [[nodiscard]] GLuint seen() const { return seen_.get(); }
  /// Row by rank, far to near.
  [[nodiscard]] GLuint order() const { return sorted_.rows.get(); }
  /// uvec4[2] a row, of what was seen.
  [[nodiscard]] GLuint splats() const { return splats_.get(); }
  /// How many rows the last run() has seen. Waits for the device.
  [[nodiscard]] std::size_t count_seen() const;

 private:
  void reserve(std::size_t capacity);
  void upload_objects(const Frame& frame);
  void project(const RowStore& rows, const Frame& frame);
  void sort(std::size_t rows);

  GlProgram project_, count_seen_, close_up_;
  RadixSort depth_sort_;
  GlBuffer objects_, splats_, keys_, group_counts_, seen_;
  Keyed sorted_, other_;
  std::size_t capacity_ = 0;
  std::vector<float> camera_from_objects_;
};

}  // namespace splatbus::viewer::gl
