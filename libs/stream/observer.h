#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "device/device.h"
#include "stream/quantised.h"

namespace splatbus::stream {

/// Reads a published model, in whichever memory it is made for, and quantises it. One observation is ids(), then
/// quantise(), then commit(); when what was read turns out not to have been whole, commit() is left out, and nothing
/// has changed. Not thread-safe.
///
/// Views have at most kMaxGaussians columns. All of it throws std::runtime_error when a device fails.
class Observer {
 public:
  virtual ~Observer() = default;

  /// As stream::choose_mean_step.
  [[nodiscard]] virtual float choose_mean_step(const GaussiansView& gaussians) = 0;

  /// The ids of the view's columns; 1, 2, ... where it has none. Valid until the next call.
  [[nodiscard]] virtual std::span<const std::uint64_t> ids(const GaussiansView& gaussians) = 0;

  /// As stream::quantise, of the view whose ids() were asked for last; `held` is null when nothing is held. What was
  /// read of the view has been read when this returns.
  virtual void quantise(const GaussiansView& gaussians, const StreamLayout& layout, const QuantisedGaussians* held,
                        std::span<const std::uint32_t> held_column) = 0;

  /// Makes `target` and `usable`, which the last commit() left, what the last quantise() read; its ids are those of
  /// ids().
  virtual void commit(QuantisedGaussians& target, std::vector<std::uint8_t>& usable) = 0;

  /// Bytes that were brought over from a device so far.
  [[nodiscard]] virtual std::uint64_t copied_bytes() const { return 0; }
};

/// `memory` is where the views lie that the observer reads. The integers are the same, bit for bit. Asserts that the
/// build has CUDA when it is asked for.
[[nodiscard]] std::unique_ptr<Observer> make_observer(Device memory);

[[nodiscard]] std::unique_ptr<Observer> make_host_observer();

}  // namespace splatbus::stream
