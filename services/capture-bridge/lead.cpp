#include "capture-bridge/lead.h"

#include <fmt/format.h>

#include <utility>

#include "bus/frames.h"
#include "wire/system_generated.h"

namespace splatbus::capture_bridge {

void Lead::take(const wire::Liveness& liveness, std::int64_t now_ns) {
  said_ns_ = liveness.header()->publish_ns();
  const std::vector<Senior> bridges = running(liveness, "capture-bridge");
  if (bridges.empty()) return;
  // At the start of everything nobody is missed, and whoever comes first begins at once.
  const bool may_miss_one = !leader_.name.empty() || has_come_again(liveness);
  if (may_miss_one && is_incomplete(liveness)) return;
  const Senior before = std::exchange(leader_, bridges.front());
  const bool another_led = !before.name.empty() || bridges.size() > 1;
  if (is_first() && before != own_ && another_led) begin_ns_ = now_ns + kHandoverNs;
}

bool Lead::may_write(std::int64_t now_ns) {
  const std::int64_t before_ns = std::exchange(asked_ns_, now_ns);
  if (before_ns != 0 && now_ns - before_ns > kStalledNs) trust_from_ns_ = now_ns;
  return is_first() && said_ns_ >= trust_from_ns_ && now_ns >= begin_ns_;
}

std::string Lead::why_not() const {
  if (leader_.name.empty()) return "waiting for the broker";
  if (leader_.name == own_.name) return "about to write: waiting until the broker has told everybody";
  return fmt::format("samples rounds for {}, which leads", bus::printable(leader_.name));
}

}  // namespace splatbus::capture_bridge
