#pragma once

#include "device/stream.h"
#include "stream/display_gaussians.h"
#include "stream/replica.h"

namespace splatbus::stream::test {

/// A replica, and the Gaussians that a viewer of it draws.
class ShownReplica : public Replica {
 public:
  explicit ShownReplica(std::size_t max_gaussians = kMaxGaussians, Device device = Device::Cpu)
      : Replica(max_gaussians), stream_(device), display_(stream_) {}

  [[nodiscard]] GaussiansView view() {
    display_.apply(take_changes());
    return display_.view();
  }

 private:
  device::Stream stream_;
  DisplayGaussians display_;
};

}  // namespace splatbus::stream::test
