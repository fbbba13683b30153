#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>

#include "gl/objects.h"
#include "viewer/gl/frame_timer.h"
#include "viewer/gl/projection.h"
#include "viewer/gl/radix_sort.h"

namespace splatbus::viewer::gl {

/// Draws what a Projection has seen in compute alone: lists for each tile of the picture which splats touch it, near to
/// far, and blends each tile from its list. The lists' room is bounded: where a picture needs more, they are empty, the
/// quads of Projection's Seen are left to be drawn, and there is more room from one of the next pictures on. Of the
/// context that was current when it was made.
class Tiles {
 public:
  /// Most pairs of a tile and a splat: 16 bytes each.
  static constexpr std::size_t kMostPairs = std::size_t{3} << 22;

  explicit Tiles(std::size_t most_pairs = kMostPairs);
  ~Tiles();
  Tiles(const Tiles&) = delete;
  Tiles& operator=(const Tiles&) = delete;

  /// `rows`: that the projection has room for. Zeroes the draw in its Seen where there is room for all.
  void list(const Projection& projection, std::size_t rows, std::uint32_t width, std::uint32_t height,
            FrameTimer& timer);
  /// What was listed: all of a picture of that size, GL_RGBA16F, transparent where nothing is.
  void blend(const Projection& projection, GLuint picture);

  /// What has become known of a picture.
  struct Listed {
    std::size_t pairs = 0;
    bool fitted = false;
    bool grown = false;  ///< there is more room now
  };
  /// Of the oldest picture that is done and was not taken. Does not wait.
  [[nodiscard]] std::optional<Listed> take();
  /// Gives back what the lists take, until the next.
  void release();
  /// Pairs that there is room for.
  [[nodiscard]] std::size_t capacity() const { return capacity_; }

 private:
  void reserve_rows(std::size_t rows);
  void reserve_pairs(std::size_t pairs);
  void reserve_tiles(std::size_t tiles);
  void ask();

  struct Asked {
    GLsync done = nullptr;
    std::size_t capacity = 0;
  };
  static constexpr std::size_t kPictures = 8;

  GlProgram count_tiles_, count_pairs_, pair_, ranges_program_, blend_;
  RadixSort tile_sort_;
  GlBuffer tile_counts_, group_counts_, pairs_, ranges_, wanted_;
  Keyed sorted_, other_;
  std::array<Asked, kPictures> asked_;
  const std::uint32_t* wanted_here_ = nullptr;  // [kPictures]
  std::size_t begun_ = 0, taken_ = 0;
  std::size_t most_pairs_;
  std::size_t rows_ = 0, capacity_ = 0, tiles_ = 0;
  std::uint32_t width_ = 0, height_ = 0;
};

}  // namespace splatbus::viewer::gl
