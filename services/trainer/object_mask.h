#pragma once

#include <cstddef>
#include <cstdint>

#include "device/stream.h"

namespace splatbus::trainer {

/// mask[i] = 255 where object_id[i] is one of `ids`, of which there are `id_count`, ascending; else 0. All on the
/// stream's device.
void mask_objects(device::StreamView stream, const std::uint32_t* object_id, std::uint32_t pixels,
                  const std::uint32_t* ids, std::uint32_t id_count, std::uint8_t* mask);

}  // namespace splatbus::trainer
