#pragma once

#include <string>

#include "bus/slab.h"

namespace splatbus::bus {

/// Where a service does its work, and so where the slabs that it makes lie. What it reads may lie anywhere.
enum class Backend { Cpu, Cuda };

/// "cpu", "cuda" or "auto": CUDA where this build has it and a device is usable. Throws Error that says why CUDA, asked
/// for by name, cannot be had.
[[nodiscard]] Backend choose_backend(const std::string& text);

[[nodiscard]] constexpr MemoryKind memory_of(Backend backend) {
  return backend == Backend::Cuda ? MemoryKind::Cuda : MemoryKind::Host;
}

[[nodiscard]] constexpr const char* name_of(Backend backend) {
  return backend == Backend::Cuda ? "cuda" : "cpu";
}

}  // namespace splatbus::bus
