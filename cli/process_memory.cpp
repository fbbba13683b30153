#include "process_memory.h"

#include <fmt/format.h>

#include <fstream>
#include <string>

namespace splatbus::cli {

std::optional<std::uint64_t> resident_bytes(pid_t pid) {
  std::ifstream file(fmt::format("/proc/{}/smaps_rollup", pid));
  std::string key;
  std::uint64_t kibibytes = 0;
  for (std::string line; file >> key;) {
    if (key == "Pss:" && file >> kibibytes) return kibibytes * 1024;
    std::getline(file, line);
  }
  return {};
}

}  // namespace splatbus::cli
