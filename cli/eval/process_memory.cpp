#include "process_memory.h"

#include <fmt/format.h>
#include <unistd.h>

#include <fstream>
#include <sstream>
#include <string>
#include <string_view>

namespace splatbus::cli {

namespace {

/// Of a file of lines such as "Pss:  12 kB".
std::optional<std::uint64_t> bytes_in(const std::string& path, std::string_view wanted) {
  std::ifstream file(path);
  std::string key;
  std::uint64_t kibibytes = 0;
  for (std::string line; file >> key;) {
    if (key == wanted && file >> kibibytes) return kibibytes * 1024;
    std::getline(file, line);
  }
  return {};
}

}  // namespace

std::optional<std::uint64_t> resident_bytes(pid_t pid) {
  return bytes_in(fmt::format("/proc/{}/smaps_rollup", pid), "Pss:");
}

std::optional<std::uint64_t> own_bytes(pid_t pid) {
  return bytes_in(fmt::format("/proc/{}/status", pid), "RssAnon:");
}

std::optional<double> processor_seconds(pid_t pid) {
  std::ifstream file(fmt::format("/proc/{}/stat", pid));
  std::string text;
  if (!std::getline(file, text)) return {};
  // The name, in parentheses, may have anything in it.
  std::istringstream fields(text.substr(text.rfind(')') + 1));
  std::string skipped;
  for (int i = 0; i < 11; ++i) fields >> skipped;
  std::uint64_t user = 0, system = 0;
  if (!(fields >> user >> system)) return {};
  return static_cast<double>(user + system) / static_cast<double>(sysconf(_SC_CLK_TCK));
}

}  // namespace splatbus::cli
