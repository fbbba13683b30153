#pragma once

#include <cstdint>

#include "bus/token_bucket.h"
#include "wire/stream_generated.h"

namespace splatbus::streamer {

/// How often one peer is listened to, by what it says; the rest is dropped.
class PeerLimits {
 public:
  [[nodiscard]] bool allow(wire::Body body, std::int64_t now_ns) {
    switch (body) {
      case wire::Body::Pose:
        return pose_.take(1, now_ns);
      case wire::Body::Probe:
        return probe_.take(1, now_ns);
      case wire::Body::Hello:
        return hello_.take(1, now_ns);
      case wire::Body::Held:
        return held_.take(1, now_ns);
      case wire::Body::Quality:
        return quality_.take(1, now_ns);
      default:
        return other_.take(1, now_ns);
    }
  }

 private:
  bus::TokenBucket pose_{200, 100}, probe_{4, 32}, hello_{5, 10}, held_{40, 40}, quality_{10, 64}, other_{10, 10};
};

}  // namespace splatbus::streamer
