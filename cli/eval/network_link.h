#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "link_schedule.h"

namespace splatbus::cli {

/// What viewers are behind.
class NetworkLink {
 public:
  virtual ~NetworkLink() = default;
  /// Where a viewer connects.
  [[nodiscard]] virtual std::string endpoint() const = 0;
  /// For the report: by what means, and of which shape.
  [[nodiscard]] virtual std::string text() const = 0;
  /// Nothing passes for so long; begins within a second. Returns when that is.
  virtual LinkCut cut(double seconds) = 0;
  /// To be called often: what a cut begins and ends.
  virtual void maintain() {}
};

enum class LinkKind { Auto, Netem, Relay };

/// Commands that give the loopback device of a network namespace a shape: packets as large as on Ethernet, and netem,
/// which holds each for half of the round trip. `cut`: everything is lost.
[[nodiscard]] std::vector<std::vector<std::string>> netem_setup(const LinkShape& shape);
[[nodiscard]] std::vector<std::string> netem_command(const char* verb, const LinkShape& shape, bool cut);

/// To be made before the streamer that listens on `streamer_port` of the loopback address. Netem takes the calling
/// thread, and with it all that it starts, into a network namespace of its own; where that cannot be (it needs
/// CAP_SYS_ADMIN, tc and the kernel's sch_netem) Auto takes a TcpRelay, and text() says why. Throws std::runtime_error.
[[nodiscard]] std::unique_ptr<NetworkLink> make_link(LinkKind kind, const LinkShape& shape,
                                                     std::uint16_t streamer_port);

}  // namespace splatbus::cli
