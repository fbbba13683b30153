#pragma once

#include <cstdint>
#include <deque>
#include <vector>

#include "stream/color_times.h"
#include "stream/gpu_rows.h"
#include "viewer/gl/batch.h"

namespace splatbus::viewer {

/// What a gl::Stage is given of a replica: the rows that have changed and nothing else. Gaussians that arrive or leave
/// fade, and those that take another row do not: whoever leaves while another takes his row vanishes in a free one.
/// One thread, the replica's.
class RowFeed {
 public:
  /// Observes the replica, which outlives this.
  RowFeed(stream::Replica& replica, bool fades);

  /// What has changed until `now_s`, which is above 0 and rises; null where nothing has.
  [[nodiscard]] gl::SharedBatch take(float now_s);
  /// All that there is, for who begins anew or has waited for too long.
  [[nodiscard]] gl::SharedBatch everything() const;
  /// Rows that were ever used.
  [[nodiscard]] std::size_t capacity() const { return records_.size(); }

 private:
  struct Displaced {
    stream::GpuRecord record;
    float fade;
    std::vector<std::uint32_t> harmonics;
  };
  void take_rows(float now_s, gl::RowUpdate& out);
  void displace(std::uint32_t row, float fade);
  /// Gives those that were displaced rows that nobody has, behind all others where there are none.
  void place_displaced(gl::RowUpdate& out);
  void fit(std::size_t harmonic_words);
  void resize(std::size_t rows);
  void add_harmonics(gl::RowUpdate& out) const;
  /// Rows that have faded away, and are free from now on.
  [[nodiscard]] std::vector<std::uint32_t> free_vanished(float now_s);
  [[nodiscard]] std::optional<gl::Bounds> bounds() const;
  void describe(gl::Batch& batch) const;

  stream::Replica& replica_;
  stream::GpuRows rows_;
  stream::ColorTimes color_times_;
  std::int64_t colors_ns_ = 0;
  bool fades_on_, begun_ = false;
  std::vector<stream::GpuRecord> records_;  ///< as they were handed on
  std::vector<float> fades_;
  std::vector<std::uint32_t> harmonics_;  ///< [rows][harmonic_words_]
  std::size_t harmonic_words_ = 0;
  struct Vanishing {
    std::uint32_t row;
    float since_s;
  };
  std::deque<Vanishing> vanishing_;
  std::vector<Displaced> displaced_;  ///< while rows are taken
  std::vector<std::uint32_t>
      spare_;  ///< rows behind the replica's that are free, or were: it may have come to have them
  float bounded_s_ = -1;
};

}  // namespace splatbus::viewer
