#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <vector>

#include "bus/context.h"
#include "bus/slab.h"
#include "bus/tensor.h"
#include "sdk/splatbus_engine.h"

namespace splatbus::engine_sdk {

/// Slab rings for frames, one for each power of two of a frame's bytes, so that cameras of many sizes make few slabs. A
/// slot holds all images of a frame. Pages that are never written take no memory.
class FrameRings {
 public:
  FrameRings(std::shared_ptr<bus::Context> context, Device kind) : context_(std::move(context)), kind_(kind) {}

  /// Copies the images of a checked frame, from whichever memory each lies in, and waits for the copies. Throws
  /// bus::Error when a slab is needed and the broker does not answer, or the device fails.
  [[nodiscard]] std::vector<bus::OutgoingTensor> write(const splatbus_frame& frame);

  /// Bytes of all images that did not stay on the device.
  [[nodiscard]] std::uint64_t host_copied_bytes() const { return host_copied_bytes_; }

 private:
  bus::Slab& ring_for(std::size_t bytes);

  std::shared_ptr<bus::Context> context_;
  Device kind_;
  std::uint64_t host_copied_bytes_ = 0;
  std::map<std::size_t, std::shared_ptr<bus::Slab>> rings_;  ///< by slot size
};

}  // namespace splatbus::engine_sdk
