#pragma once

#include <memory>
#include <string>
#include <vector>

#include "gl/context.h"
#include "sim/readback.h"

namespace splatbus::sim {

/// Hands pictures over in CUDA memory, without a copy through the host.
class DeviceReadback : public Readback {
 public:
  /// The pictures taken since each begin() after the last finish(), in that order, complete and in the layout that the
  /// host would read. All are waited for together. Valid until the next begin(). Throws std::runtime_error.
  [[nodiscard]] virtual const std::vector<std::vector<splatbus_image>>& finish() = 0;
  /// Of the first `cameras` since the last finish(); what was begun after them is not wanted.
  virtual void keep(std::size_t cameras) = 0;
};

/// A context of the first CUDA device where `backend` wants it and there is one, else any. Throws as GlContext, and for
/// cuda where there is none.
[[nodiscard]] std::shared_ptr<GlContext> make_context(const std::string& backend);

/// By `backend`: null for cpu; for auto null, too, where there is no CUDA or the context, which is current, renders on
/// something else than the first CUDA device. For cuda these throw std::runtime_error. The context lives longer.
[[nodiscard]] std::unique_ptr<DeviceReadback> make_device_readback(const GlContext& context,
                                                                   const std::string& backend);

}  // namespace splatbus::sim
