#include "link_schedule.h"

#include <fmt/format.h>

#include <algorithm>

namespace splatbus::cli {

std::string LinkShape::text() const {
  std::string text = mbps > 0 ? fmt::format("{:g} Mbit/s", mbps) : "any rate";
  if (round_trip_ms > 0) text += fmt::format(", {:g} ms round trip", round_trip_ms);
  if (loss > 0) text += fmt::format(", {:g} % loss", loss * 100);
  return text;
}

std::int64_t repeated_until_passed(std::int64_t first_ns, std::int64_t timeout_ns, const LinkCut& cut) {
  std::int64_t at_ns = first_ns;
  while (cut.contains(at_ns)) {
    at_ns += timeout_ns;
    timeout_ns *= 2;
  }
  return at_ns;
}

std::int64_t LinkSchedule::send(std::size_t bytes, std::int64_t now_ns) {
  const double line_ns = shape_.mbps > 0 ? static_cast<double>(bytes) * 8000 / shape_.mbps : 0;
  std::int64_t left_ns = std::max(line_free_ns_, now_ns) + static_cast<std::int64_t>(line_ns);
  left_ns = repeated_until_passed(left_ns, kTimeoutNs + round_trip_ns(), cut_);
  line_free_ns_ = left_ns;
  std::int64_t there_ns = left_ns + round_trip_ns() / 2;
  for (std::int64_t wait_ns = round_trip_ns(); lost(); wait_ns = kTimeoutNs + round_trip_ns()) there_ns += wait_ns;
  last_ns_ = std::max(last_ns_, there_ns);
  return last_ns_;
}

}  // namespace splatbus::cli
