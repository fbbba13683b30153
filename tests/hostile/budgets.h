#pragma once

#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

namespace splatbus::hostile {

/// Resident memory of a process, bytes; 0 when it is gone.
inline std::size_t resident_bytes(int pid) {
  std::ifstream file("/proc/" + std::to_string(pid) + "/statm");
  std::size_t total = 0, resident = 0;
  file >> total >> resident;
  return resident * 4096;
}

inline std::size_t open_descriptors(int pid) {
  std::error_code error;
  std::filesystem::directory_iterator entries("/proc/" + std::to_string(pid) + "/fd", error);
  return error ? 0 : static_cast<std::size_t>(std::distance(entries, {}));
}

inline constexpr std::size_t kMiB = std::size_t{1} << 20;

}  // namespace splatbus::hostile
