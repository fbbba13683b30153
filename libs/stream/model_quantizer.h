#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "device/device.h"
#include "stream/held_gaussians.h"
#include "stream/quantized.h"

namespace splatbus::stream {

/// Indices of a model are below it; of more than kMaxGaussians Gaussians a part is served.
inline constexpr std::size_t kMaxModelGaussians = std::size_t{1} << 24;

/// Reads a published model in the memory of one device and makes integers of it there: the same on either, bit for bit.
/// They are kept from one observation to the next, so that only those that have changed come to the host, or all of
/// them, packed, when many have. One observation is ids(), then quantize(), then commit(); when what was read turns out
/// not to have been whole, commit() is left out, and nothing has changed. Not thread-safe.
///
/// Columns are numbered in the order of the view's ranges, without gaps: those of one observation need not be those of
/// the next. Views have at most kMaxModelGaussians. Works on a stream of its own, which each call waits for. All of it
/// throws std::runtime_error when a device fails.
class ModelQuantizer {
 public:
  explicit ModelQuantizer(Device device);
  ~ModelQuantizer();
  ModelQuantizer(ModelQuantizer&&) noexcept;
  ModelQuantizer& operator=(ModelQuantizer&&) = delete;

  /// A 32nd of the median Gaussian's extent (second largest scale), rounded down to a power of two, between 2^-20 and 1
  /// m; 2^-11 m when there is none. Error of a mean: at most half of that, under 2 % of a typical Gaussian's sigma.
  [[nodiscard]] float choose_mean_step(const GaussiansView& gaussians);

  /// The ids of the view's columns; index + 1 where it has none. Valid until the next call.
  [[nodiscard]] std::span<const std::uint64_t> ids(const GaussiansView& gaussians);

  /// Nearest integers of all columns of the view whose ids() were asked for last. Reads parameters, normal and
  /// visibility (Transfer; null: up, 1) and object_id (null: 0). Values are clamped to the layout's range. A Gaussian
  /// with a value that is not finite is not usable, and all zero. `held_column[i]` is the row of `held` that
  /// Gaussian i has, or kNotHeld: its rotation is then written as the equivalent one nearest to that which is held.
  /// `held` is null when nothing is.
  void quantize(const GaussiansView& gaussians, const StreamLayout& layout, const HeldGaussians* held,
                std::span<const std::uint32_t> held_column);

  /// Makes `target` and `usable`, which the last commit() left, what the last quantize() read; its ids are those of
  /// ids().
  void commit(QuantizedGaussians& target, std::vector<std::uint8_t>& usable);

  /// Bytes that were brought over from a device so far.
  [[nodiscard]] std::uint64_t copied_bytes() const;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace splatbus::stream
