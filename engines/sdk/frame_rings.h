#pragma once

#include <map>
#include <memory>
#include <vector>

#include "bus/context.h"
#include "bus/tensor.h"
#include "sdk/splatbus_engine.h"

namespace splatbus::engine_sdk {

/// Slab rings for frames, one for each power of two of a frame's bytes, so that cameras of many sizes make few slabs. A
/// slot holds all images of a frame. Pages that are never written take no memory.
class FrameRings {
 public:
  explicit FrameRings(std::shared_ptr<bus::Context> context) : context_(std::move(context)) {}

  /// Copies the images of a checked frame. Throws bus::Error when a slab is needed and the broker does not answer.
  [[nodiscard]] std::vector<bus::OutgoingTensor> write(const splatbus_frame& frame);

 private:
  bus::Slab& ring_for(std::size_t bytes);

  std::shared_ptr<bus::Context> context_;
  std::map<std::size_t, std::shared_ptr<bus::Slab>> rings_;  ///< by slot size
};

}  // namespace splatbus::engine_sdk
