#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

namespace splatbus::cli {

/// One GPU, as nvidia-smi describes it.
struct GpuUsage {
  std::string name, driver;
  double busy_percent = 0, used_mib = 0, total_mib = 0;
};

/// Every NVIDIA GPU of this machine; empty where there is none, or no nvidia-smi on PATH. Takes some 50 ms.
[[nodiscard]] std::vector<GpuUsage> query_gpus();
/// MiB of GPU memory by process.
[[nodiscard]] std::map<std::uint32_t, double> query_gpu_memory();

/// What `nvidia-smi --format=csv,noheader,nounits` prints; a line that makes no sense is left out, "[N/A]" is 0.
[[nodiscard]] std::vector<GpuUsage> parse_gpus(const std::string& csv);
[[nodiscard]] std::map<std::uint32_t, double> parse_gpu_memory(const std::string& csv);

}  // namespace splatbus::cli
