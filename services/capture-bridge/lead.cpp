#include "capture-bridge/lead.h"

#include <utility>

#include "wire/system_generated.h"

namespace splatbus::capture_bridge {

void Lead::take(const wire::Liveness& liveness, std::int64_t now_ns) {
  said_ns_ = liveness.header()->publish_ns();
  const std::vector<Senior> bridges = running(liveness, "capture-bridge");
  if (bridges.empty() || (is_incomplete(liveness) && !leader_.name.empty())) return;
  const Senior before = std::exchange(leader_, bridges.front());
  const bool another_led = !before.name.empty() || bridges.size() > 1;
  if (is_first() && before != own_ && another_led) begin_ns_ = now_ns + kHandoverNs;
}

bool Lead::may_write(std::int64_t now_ns) {
  const std::int64_t before_ns = std::exchange(asked_ns_, now_ns);
  if (before_ns != 0 && now_ns - before_ns > kStalledNs) trust_from_ns_ = now_ns;
  return is_first() && said_ns_ >= trust_from_ns_ && now_ns >= begin_ns_;
}

}  // namespace splatbus::capture_bridge
