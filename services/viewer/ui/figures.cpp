#include "viewer/ui/figures.h"

#include <fmt/format.h>

#include <algorithm>

#include "viewer/ui/texts.h"

namespace splatbus::viewer {
namespace {

// A scene that lives stands still now and then, when its news come late: that is no rest yet.
constexpr std::int64_t kRestNs = 2'000'000'000;
constexpr double kRestPictures = 3;  // of a slow device
constexpr std::int64_t kRateOverNs = 3'000'000'000;

std::string in_thousands(std::size_t count) {
  std::string text = std::to_string(count);
  for (auto at = static_cast<std::ptrdiff_t>(text.size()) - 3; at > 0; at -= 3) {
    text.insert(static_cast<std::size_t>(at), 1, ',');
  }
  return text;
}

std::string ms(double value) {
  return fmt::format("{:.{}f} ms", value, value < 10 ? 1 : 0);
}

std::string known_ms(const std::optional<double>& value) {
  return value ? ms(*value) : texts::kUnknown;
}

std::string rate(const StreamFigures& stream) {
  if (stream.max_kbps == 0) return fmt::format("{:.2f}", stream.megabits);
  return fmt::format("{:.2f} of {:g}", stream.megabits, stream.max_kbps / 1000.0);
}

}  // namespace

void FrameRate::drawn(std::int64_t now_ns) {
  const double interval_ms = static_cast<double>(now_ns - last_ns_) / 1e6;
  const bool first = last_ns_ == 0 || rests(now_ns);
  last_ns_ = now_ns;
  if (first) {
    frame_ms_ = 0;
  } else {
    frame_ms_ += (frame_ms_ == 0 ? 1 : 0.1) * (interval_ms - frame_ms_);
  }
}

std::optional<double> FrameRate::frame_ms(std::int64_t now_ns) const {
  if (frame_ms_ == 0 || rests(now_ns)) return std::nullopt;
  return frame_ms_;
}

bool FrameRate::rests(std::int64_t now_ns) const {
  return static_cast<double>(now_ns - last_ns_) >
         std::max(static_cast<double>(kRestNs), kRestPictures * 1e6 * frame_ms_);
}

void ByteRate::add(std::int64_t now_ns, std::uint64_t bytes) {
  if (!samples_.empty() && bytes < samples_.back().bytes) samples_.clear();  // counted anew
  samples_.push_back({now_ns, bytes});
  while (samples_.size() > 2 && now_ns - samples_.front().ns > kRateOverNs) samples_.pop_front();
}

double ByteRate::megabits() const {
  if (samples_.size() < 2) return 0;
  const Sample &first = samples_.front(), &last = samples_.back();
  if (last.ns <= first.ns) return 0;
  return 8e3 * static_cast<double>(last.bytes - first.bytes) / static_cast<double>(last.ns - first.ns);
}

std::vector<std::pair<std::string, std::string>> figure_rows(const Figures& figures, std::optional<double> frame_ms,
                                                             float resolution) {
  std::vector<std::pair<std::string, std::string>> rows;
  rows.emplace_back(texts::kFrames, frame_ms ? fmt::format("{:.0f}", 1000 / *frame_ms) : texts::kAtRest);
  rows.emplace_back(texts::kFrame, known_ms(frame_ms));
  if (figures.held) rows.emplace_back(texts::kGaussians, in_thousands(*figures.held));
  if (figures.drawn) rows.emplace_back(texts::kDrawn, in_thousands(*figures.drawn));
  if (figures.stream) {
    const StreamFigures& stream = *figures.stream;
    rows.emplace_back(texts::kRate, rate(stream));
    rows.emplace_back(texts::kRoundTrip, known_ms(stream.round_trip_ms));
    rows.emplace_back(texts::kAge, known_ms(stream.age_ms));
    rows.emplace_back(texts::kMissing, stream.missing_pages == 0   ? texts::kNothing
                                       : stream.missing_pages == 1 ? texts::kOnePage
                                                                   : fmt::format(texts::kPages, stream.missing_pages));
  }
  rows.emplace_back(texts::kResolution, fmt::format("{:.0f} %", 100 * resolution));
  if (figures.stream) {
    rows.emplace_back(texts::kConnection, figures.stream->connected ? texts::kConnected : texts::kConnecting);
  }
  return rows;
}

}  // namespace splatbus::viewer
