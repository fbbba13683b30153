#pragma once

#include <compare>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace splatbus::wire {
struct Liveness;
}  // namespace splatbus::wire

namespace splatbus::capture_bridge {

/// A process by how long it has been there: who was first goes first, so that one that is started again leads nobody
/// who has led meanwhile. Of processes on one machine: on another the clock counts from another instant, and what the
/// order is of two is then arbitrary, though the same for everybody who compares them.
struct Senior {
  std::uint64_t since_ns = 0;  ///< CLOCK_MONOTONIC
  std::string name;
  auto operator<=>(const Senior&) const = default;
};

inline constexpr std::size_t kMaxSeniors = 64;

/// A broker that was started just now has not heard everybody yet: nobody is gone for not being in its list.
[[nodiscard]] bool is_incomplete(const wire::Liveness& liveness);

/// Whether somebody was there before the broker: it has been started again, and whom it does not hear yet may lead.
[[nodiscard]] bool has_come_again(const wire::Liveness& liveness);

/// Those of that kind that run, as the broker sees them: the first kMaxSeniors, oldest first.
[[nodiscard]] std::vector<Senior> running(const wire::Liveness& liveness, std::string_view kind);

}  // namespace splatbus::capture_bridge
