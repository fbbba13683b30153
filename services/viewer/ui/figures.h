#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace splatbus::viewer {

/// Of a stream.
struct StreamFigures {
  bool connected = false;
  double megabits = 0;         ///< a second
  std::uint32_t max_kbps = 0;  ///< that were asked for; 0: none were
  std::optional<double> round_trip_ms, age_ms;
  std::size_t missing_pages = 0;
};

/// What is said over the picture; of what is not known, nothing or a dash.
struct Figures {
  std::optional<std::size_t> held, drawn;  ///< Gaussians
  std::optional<StreamFigures> stream;
};

/// How fast pictures follow one another while something moves. Times are of any steady clock, nanoseconds.
class FrameRate {
 public:
  void drawn(std::int64_t now_ns);
  /// Milliseconds a picture; nullopt while nothing moves.
  [[nodiscard]] std::optional<double> frame_ms(std::int64_t now_ns) const;

 private:
  [[nodiscard]] bool rests(std::int64_t now_ns) const;

  std::int64_t last_ns_ = 0;
  double frame_ms_ = 0;
};

/// Over the last few seconds.
class ByteRate {
 public:
  void add(std::int64_t now_ns, std::uint64_t bytes);
  [[nodiscard]] double megabits() const;

 private:
  struct Sample {
    std::int64_t ns;
    std::uint64_t bytes;
  };
  std::deque<Sample> samples_;
};

/// Name and value. `resolution` as Settings'.
[[nodiscard]] std::vector<std::pair<std::string, std::string>> figure_rows(const Figures& figures,
                                                                           std::optional<double> frame_ms,
                                                                           float resolution);

}  // namespace splatbus::viewer
