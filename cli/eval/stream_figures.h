#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "dynamics_figures.h"
#include "wire/stream_generated.h"

namespace splatbus::cli {

/// A packet at the viewer.
struct Arrival {
  std::int64_t at_ns = 0;
  wire::Body body{};
  std::size_t bytes = 0;
};

/// A delta of pages, or a part of a whole one: when the streamer encoded it, and when it was in the viewer's replica.
struct Delivery {
  std::int64_t encoded_ns = 0, there_ns = 0;
  bool whole = false;
};

/// The same pictures at the server and at the viewer, means over the cameras of a round, at a time of the run.
struct StreamSample {
  double time_s = 0;
  double ssim_server = 0, ssim_viewer = 0;
  [[nodiscard]] double gap() const { return ssim_server - ssim_viewer; }
};

/// A viewer that comes to a world which is there, seconds from its start; nullopt: not in the time that it had.
struct StreamJoin {
  std::optional<double> first_s, whole_s;
  /// Until its SSIM is at most kNearGap, kCloseGap farther below the server's than that of a viewer which has been
  /// there.
  std::optional<double> near_s, close_s;
};
inline constexpr double kNearGap = 0.05, kCloseGap = 0.005;

/// One second of the streamer's process.
struct ServerSample {
  double time_s = 0;
  std::size_t viewers = 0;  ///< that were there
  double tick_ms = 0;       ///< its last tick: observing and encoding
  double cpu_share = 0;     ///< of one core
  double resident_mb = 0;   ///< 1e6 bytes
};

/// What a run with so many viewers was like at the server.
struct ViewersStage {
  std::size_t viewers = 0;
  double from_s = 0, to_s = 0;
  std::size_t whole = 0;  ///< most of the light-weight ones that had everything at once
};

/// One run of the pipeline with a viewer behind a link. Times of the run count from `begin_ns`.
struct StreamResults {
  std::string link;  ///< what it was behind
  double mbps = 0;   ///< of its shape; 0: no limit
  std::int64_t begin_ns = 0;
  double end_s = 0;
  std::optional<double> whole_s;  ///< when the viewer had everything for the first time
  std::vector<Arrival> arrivals;
  std::vector<StreamSample> samples;
  std::vector<ServerSample> server;
  std::vector<ViewersStage> stages;
  StreamJoin join;
  std::vector<Delivery> deliveries;
  double tick_hz = 0;
  std::uint64_t gaussians = 0;
  std::uint64_t refused = 0;
  std::optional<TimeWindow> cut;
  std::optional<double> cut_fresh_s,
      cut_whole_s;  ///< from its end: a delta that is new; SSIM as before, within kCloseGap
};

/// Megabits (1e6) in each whole second of the window, from its start, by packet type; only types that came.
using BitsBySecond = std::map<wire::Body, std::vector<double>>;
[[nodiscard]] BitsBySecond megabits_by_second(std::span<const Arrival> arrivals, std::int64_t begin_ns,
                                              const TimeWindow& window);
[[nodiscard]] std::vector<double> total_of(const BitsBySecond& bits);
/// Most megabits in any second, wherever it begins, that lies in the window.
[[nodiscard]] double peak_megabits(std::span<const Arrival> arrivals, std::int64_t begin_ns, const TimeWindow& window);

[[nodiscard]] std::optional<double> median(std::vector<double> values);

/// The figures of one run, judged from when the viewer had everything for the first time, or from half of the run on
/// where it never had. null where nothing was measured.
[[nodiscard]] nlohmann::json summarize_stream(const StreamResults& results);

}  // namespace splatbus::cli
