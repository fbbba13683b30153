#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "bus/memory_pool.h"
#include "bus/subscriber.h"
#include "trainer/view_store.h"

namespace splatbus::trainer {

/// A capture/reference message: a view, a camera that retires, or a picture that was overwritten before it could be
/// copied (`lost`).
struct ReferenceReading {
  ViewKey key;
  bool retire = false, lost = false;
  TrainingViewPtr view;
};

/// Copies capture/reference messages out of the engine's slabs, whichever memory those lie in, into memory of one kind.
/// One thread; what it read may outlive it.
class ReferenceReader {
 public:
  /// No picture may have more than `max_pixels`, and no camera's pictures may take more than `max_bytes`. What passes
  /// through the host is added to `host_bytes`.
  ReferenceReader(Device memory, std::size_t max_pixels, std::size_t max_bytes, std::atomic<std::uint64_t>& host_bytes);

  /// Throws bus::Error or std::runtime_error when the message lies or is beyond a bound, MemoryFailure.
  [[nodiscard]] ReferenceReading read(const bus::Message& message, bool with_depth);

 private:
  template <class T>
  [[nodiscard]] bool read_picture(const bus::Message& message, const char* name, std::vector<std::uint32_t> shape,
                                  Pixels<T>& out);
  /// With what the far field's Gaussians show in it (sky_albedo.h).
  [[nodiscard]] bool read_albedo(const bus::Message& message, TrainingView& view);
  /// And how far the farthest surfaces are in it (farthest_surfaces.h).
  [[nodiscard]] bool read_depth(const bus::Message& message, TrainingView& view);
  /// Of the objects that are not to be modelled.
  [[nodiscard]] bool read_mask(const bus::Message& message, TrainingView& view);

  Device memory_;
  std::size_t max_pixels_, max_bytes_;
  std::atomic<std::uint64_t>& host_bytes_;
  bus::MemoryPool pool_;
};

/// The camera of the message alone, without its pictures.
[[nodiscard]] ViewKey reference_key(const bus::Message& message);

}  // namespace splatbus::trainer
