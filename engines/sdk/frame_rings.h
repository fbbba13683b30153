#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "bus/context.h"
#include "bus/slab.h"
#include "bus/tensor.h"
#include "sdk/splatbus_engine.h"

namespace splatbus::engine_sdk {

/// Of slots for frames of one size. A FrameSender registers it with the bus, under its own lock.
struct FrameRing {
  std::string role;
  std::shared_ptr<bus::Slab> slab;
  std::int64_t used_ns = 0;  ///< last
  bool registered = false;   ///< readers can open it
  std::string refusal;       ///< why the bus will not have it
};

/// A frame's images in a slot of a ring.
struct WrittenFrame {
  std::shared_ptr<FrameRing> ring;  ///< null: it has none
  std::vector<bus::OutgoingTensor> tensors;
};

/// Slab rings for frames, one for each power of two of a frame's bytes, so that cameras of many sizes make few slabs. A
/// slot holds all images of a frame. Pages that are never written take no memory, and a ring of which nobody has wanted
/// a slot for `kUnusedNs` goes: one large picture takes its memory no longer than that.
class FrameRings {
 public:
  static constexpr std::int64_t kUnusedNs = 30'000'000'000;

  FrameRings(std::shared_ptr<bus::Context> context, Device kind) : context_(std::move(context)), kind_(kind) {}

  /// Copies the images of the first of some checked frames, from whichever memory each lies in: of as many as half of a
  /// ring holds, so that readers have time for them. Waits for the copies together, never for the broker. Throws
  /// bus::Error when there is no memory for a ring, or the device fails; no copy is under way then.
  [[nodiscard]] std::vector<WrittenFrame> write(std::span<const splatbus_frame> frames, std::int64_t now_ns);

  /// Takes out the rings that nobody has written to for long, and none of whose frames are still to be sent.
  [[nodiscard]] std::vector<std::shared_ptr<FrameRing>> take_unused(std::int64_t now_ns);

  /// The next frame of its size gets another ring.
  void forget(const FrameRing& ring);

  /// Bytes of all images that did not stay on the device.
  [[nodiscard]] std::uint64_t host_copied_bytes() const { return host_copied_bytes_; }

 private:
  /// A frame whose images are being copied.
  struct BegunFrame {
    const splatbus_frame* frame = nullptr;
    std::shared_ptr<FrameRing> ring;  ///< null: it has no images
    std::size_t slot = 0;
  };
  [[nodiscard]] BegunFrame begin(const splatbus_frame& frame, std::int64_t now_ns);
  /// Waits for their copies.
  [[nodiscard]] static std::vector<WrittenFrame> finish(const std::vector<BegunFrame>& begun);
  const std::shared_ptr<FrameRing>& ring_for(std::size_t bytes);

  std::shared_ptr<bus::Context> context_;
  Device kind_;
  std::uint64_t host_copied_bytes_ = 0;
  std::map<std::size_t, std::shared_ptr<FrameRing>> rings_;  ///< by slot size
};

}  // namespace splatbus::engine_sdk
