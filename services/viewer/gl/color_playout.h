#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "viewer/gl/row_store.h"

namespace splatbus::viewer::gl {

/// Colors of rows in the scene that they were shaded for: those to come begin when the time of those before has been
/// played out, and pictures go from one to the other. What is shaded later may be of an earlier time, as shadows are,
/// which come later than their scene: no row goes back to colors that were shaded before those that it has. Times are
/// of the engine's clock, 0 where nobody knows. As the page's (web/src/motion/color_playout.ts).
class ColorPlayout {
 public:
  /// Updates that wait for their time, and rows of all of them; where there are more the oldest begins at once.
  static constexpr std::size_t kMostWaiting = 32;
  static constexpr std::size_t kMostRows = std::size_t{1} << 24;  ///< 128 MiB

  explicit ColorPlayout(std::size_t most_rows = kMostRows) : most_rows_(most_rows) {}

  /// All rows are new, with colors of this time.
  void restart(std::int64_t of_ns);
  /// Rows were written with newer colors than any that wait.
  void wrote(std::span<const std::uint32_t> rows);
  /// `scene_ns`: of the newest scene; none are of a later one. Nobody knows when that was of which the time is 0: it is
  /// shown at once.
  void add(const ColorUpdate& colors, std::int64_t of_ns, std::int64_t scene_ns);

  /// Goes on to what was at this time; 0: to the newest that there is.
  void advance(std::int64_t shown_ns, RowStore& rows);
  /// How far it is from the colors that are kept to those that there are.
  [[nodiscard]] float part() const { return part_; }
  /// Other colors are on their way.
  [[nodiscard]] bool moving() const { return !waiting_.empty() || part_ < 1; }

 private:
  struct Waiting {
    ColorUpdate colors;
    std::int64_t of_ns;
    std::int64_t came_ns;  ///< what was played out when they came
    std::uint64_t sequence;
  };
  [[nodiscard]] bool is_due(const Waiting& next, std::int64_t shown_ns) const;
  void stamp(std::span<const std::uint32_t> rows, std::uint64_t sequence);
  /// Leaves out the rows that have newer colors.
  void keep_newer(Waiting& waiting) const;

  std::size_t most_rows_;
  std::vector<Waiting> waiting_;        ///< by of_ns, those of one time as they came
  std::size_t waiting_rows_ = 0;        ///< of all of them
  std::vector<std::uint64_t> written_;  ///< by row, sequence of what wrote it, where something older waits
  std::uint64_t sequence_ = 0;
  std::int64_t from_ns_ = 0, to_ns_ = 0, scene_ns_ = 0, shown_ns_ = 0;
  float part_ = 1;
};

}  // namespace splatbus::viewer::gl
