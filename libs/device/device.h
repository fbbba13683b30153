#pragma once

#include <cstdint>

namespace splatbus {

/// Where work is done and where memory lies. The numbers are those of the slab registry's protocol and of the SDK's
/// splatbus_memory.
enum class Device : std::uint32_t { Cpu = 0, Cuda = 1 };

[[nodiscard]] constexpr const char* name_of(Device device) {
  return device == Device::Cuda ? "cuda" : "cpu";
}

}  // namespace splatbus
