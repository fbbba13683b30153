#include "gpu_usage.h"

#include <charconv>
#include <cstdio>
#include <memory>
#include <sstream>

namespace splatbus::cli {

namespace {

/// What a command prints; nothing when it is not there or fails. It is a constant of this file, never what a user
/// types.
std::string output_of(const char* command) {
  const std::unique_ptr<FILE, int (*)(FILE*)> pipe(::popen(command, "re"), ::pclose);
  std::string text;
  char buffer[512];
  while (pipe != nullptr) {
    const std::size_t bytes = std::fread(buffer, 1, sizeof buffer, pipe.get());
    if (bytes == 0) break;
    text.append(buffer, bytes);
  }
  return text;
}

std::vector<std::string> cells_of(const std::string& line) {
  std::vector<std::string> cells;
  std::istringstream stream(line);
  for (std::string cell; std::getline(stream, cell, ',');) {
    cells.push_back(cell.substr(std::min(cell.find_first_not_of(' '), cell.size())));
  }
  return cells;
}

double number_of(const std::string& cell) {
  double value = 0;
  std::from_chars(cell.data(), cell.data() + cell.size(), value);
  return value;
}

}  // namespace

std::vector<GpuUsage> parse_gpus(const std::string& csv) {
  std::vector<GpuUsage> result;
  std::istringstream lines(csv);
  for (std::string line; std::getline(lines, line);) {
    const auto cells = cells_of(line);
    if (cells.size() != 5) continue;
    result.push_back({cells[0], cells[1], number_of(cells[2]), number_of(cells[3]), number_of(cells[4])});
  }
  return result;
}

std::map<std::uint32_t, double> parse_gpu_memory(const std::string& csv) {
  std::map<std::uint32_t, double> result;
  std::istringstream lines(csv);
  for (std::string line; std::getline(lines, line);) {
    const auto cells = cells_of(line);
    if (cells.size() == 2) result[static_cast<std::uint32_t>(number_of(cells[0]))] += number_of(cells[1]);
  }
  return result;
}

std::vector<GpuUsage> query_gpus() {
  return parse_gpus(
      output_of("nvidia-smi --query-gpu=name,driver_version,utilization.gpu,memory.used,memory.total "
                "--format=csv,noheader,nounits 2>/dev/null"));
}

std::map<std::uint32_t, double> query_gpu_memory() {
  return parse_gpu_memory(
      output_of("nvidia-smi --query-compute-apps=pid,used_memory --format=csv,noheader,nounits 2>/dev/null"));
}

}  // namespace splatbus::cli
