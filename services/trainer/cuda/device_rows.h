#pragma once

#include "trainer/cuda/insert_kernels.h"
#include "trainer/insert_batch.h"

namespace splatbus::trainer::cuda {

/// Rows in device memory, for kernels.
[[nodiscard]] inline DeviceRows device_rows(const InsertRows& rows) {
  return {.stride = static_cast<std::int64_t>(rows.stride),
          .mean = rows.mean,
          .log_scale = rows.log_scale,
          .rotation = rows.rotation,
          .opacity_logit = rows.opacity_logit,
          .albedo = rows.albedo,
          .normal = rows.normal,
          .visibility = rows.visibility,
          .object_id = rows.object_id,
          .cell = rows.cell};
}

}  // namespace splatbus::trainer::cuda
