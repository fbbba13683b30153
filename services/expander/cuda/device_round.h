#pragma once

#include <atomic>
#include <cstdint>
#include <memory>

#include "expander/cuda/kernels.h"
#include "expander/cuda/pool.h"
#include "expander/round.h"

namespace splatbus::expander::cuda {

/// A round in device memory. Samples that are garbage stay in their places and are marked, so that nothing moves.
class DeviceRound final : public Round {
 public:
  /// Copies a round, reading it in place where it lies on the device, and waits for that. Null when a slab has moved on
  /// meanwhile. Adds what came from the host to `host_bytes`. Throws.
  [[nodiscard]] static std::unique_ptr<DeviceRound> take(const IncomingRound& incoming, Pool& pool,
                                                         std::atomic<std::uint64_t>& host_bytes);

  [[nodiscard]] const RoundInfo& info() const override { return info_; }
  [[nodiscard]] std::size_t size() const override { return view_.count - dropped_; }
  [[nodiscard]] std::size_t dropped() const override { return dropped_; }
  [[nodiscard]] const RoundView& view() const { return view_; }

 private:
  DeviceRound(const IncomingRound& incoming, Pool& pool);

  RoundInfo info_;
  std::shared_ptr<std::byte> memory_;
  RoundView view_{};
  std::uint32_t* dropped_count_ = nullptr;  // on the device
  std::uint32_t dropped_ = 0;
};

}  // namespace splatbus::expander::cuda
