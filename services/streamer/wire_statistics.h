#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "wire/stream_generated.h"

namespace splatbus::streamer {

/// Bytes on the wire to viewers, by packet type. Rates are of the model's stream: ProbePictures, which only
/// measurements ask for, are counted but left out of them.
class WireStatistics {
 public:
  struct Type {
    std::uint64_t packets = 0, total_bytes = 0, window_bytes = 0;
  };
  static constexpr std::size_t kTypes = static_cast<std::size_t>(wire::Body::MAX) + 1;

  void add(wire::Body body, std::size_t bytes) {
    Type& type = types_[static_cast<std::size_t>(body)];
    ++type.packets;
    type.total_bytes += bytes;
    type.window_bytes += bytes;
  }

  /// The first viewer's Hello: the mean counts from here.
  void begin(std::int64_t now_ns) {
    if (begin_ns_ == 0) begin_ns_ = window_begin_ns_ = now_ns;
  }

  /// What one window had, and begins the next.
  struct Window {
    double seconds = 0, mbps = 0, mbps_mean = 0, mbps_peak = 0;
    std::uint64_t bytes = 0, total_bytes = 0;
    std::array<Type, kTypes> types{};
  };
  Window close_window(std::int64_t now_ns) {
    Window window{.types = types_};
    std::uint64_t model_window = 0, model_total = 0;
    for (std::size_t i = 0; i < kTypes; ++i) {
      window.bytes += types_[i].window_bytes;
      window.total_bytes += types_[i].total_bytes;
      if (i == static_cast<std::size_t>(wire::Body::ProbePicture)) continue;
      model_window += types_[i].window_bytes;
      model_total += types_[i].total_bytes;
    }
    for (Type& type : types_) type.window_bytes = 0;
    if (begin_ns_ == 0) return window;
    window.seconds = static_cast<double>(now_ns - window_begin_ns_) / 1e9;
    const double since_begin = static_cast<double>(now_ns - begin_ns_) / 1e9;
    if (window.seconds > 0) window.mbps = static_cast<double>(model_window) * 8e-6 / window.seconds;
    if (since_begin > 0) window.mbps_mean = static_cast<double>(model_total) * 8e-6 / since_begin;
    // Shorter windows say little.
    if (window.seconds > 0.5 && window.mbps > peak_) peak_ = window.mbps;
    window.mbps_peak = peak_;
    window_begin_ns_ = now_ns;
    return window;
  }

 private:
  std::array<Type, kTypes> types_{};
  std::int64_t begin_ns_ = 0, window_begin_ns_ = 0;
  double peak_ = 0;
};

}  // namespace splatbus::streamer
