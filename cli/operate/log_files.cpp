#include "log_files.h"

#include <fmt/format.h>

#include <algorithm>
#include <fstream>
#include <iterator>
#include <utility>

namespace splatbus::cli {

namespace fs = std::filesystem;

namespace {

constexpr const char* kEventMark = " * ";

struct FilePart {
  std::vector<StoredLine> lines;
  bool enough = false;  ///< what stands before in this file, or in older ones, is not wanted
};

/// What is wanted of a file's first bytes: read from the end, and no more of it than about twice what it takes.
FilePart read_file(const fs::path& file, const std::string& process, const Extent& wanted, std::uintmax_t bytes) {
  constexpr std::uintmax_t kFirstLook = std::uintmax_t{64} << 10;
  std::error_code error;
  bytes = std::min(bytes, fs::file_size(file, error));
  std::ifstream stream(file);
  if (error || !stream) return {};
  const bool all = wanted.tail < 0 && wanted.since.empty();
  for (std::uintmax_t look = all ? bytes : std::min(bytes, kFirstLook);; look = std::min(bytes, 2 * look)) {
    FilePart part;
    std::string text;
    std::uintmax_t at = bytes - look;
    stream.clear();
    stream.seekg(static_cast<std::streamoff>(at));
    if (at > 0 && std::getline(stream, text)) at += text.size() + 1;  // the end of a line, mostly
    for (; at < bytes && std::getline(stream, text); at += text.size() + 1) {
      auto line = parse_line(process, text);
      if (line && line->time < wanted.since) {
        part.enough = true;
      } else if (line) {
        part.lines.push_back(std::move(*line));
      }
    }
    const bool is_tail = wanted.tail >= 0 && part.lines.size() >= static_cast<std::size_t>(wanted.tail);
    part.enough = part.enough || is_tail;
    if (part.enough || look == bytes) return part;
  }
}

}  // namespace

fs::path current_file(const fs::path& folder, const std::string& process) {
  return folder / (process + ".log");
}

std::optional<StoredLine> parse_line(const std::string& process, const std::string& line) {
  const std::size_t end = line.find(' ');
  if (end == std::string::npos || line.size() < end + 3) return {};
  return StoredLine{line.substr(0, end), process, line.substr(end + 3), line.compare(end, 3, kEventMark) == 0};
}

std::vector<fs::path> files_of(const fs::path& folder, const std::string& process) {
  std::vector<fs::path> files{current_file(folder, process)};
  for (int number = 1; fs::exists(folder / fmt::format("{}.{}.log", process, number)); ++number) {
    files.push_back(folder / fmt::format("{}.{}.log", process, number));
  }
  return files;
}

void read_files(std::span<const fs::path> files, const std::string& process, Extent wanted, std::uintmax_t of_newest,
                std::vector<StoredLine>& lines) {
  std::vector<FilePart> parts;
  for (const fs::path& file : files) {
    parts.push_back(read_file(file, process, wanted, parts.empty() ? of_newest : kAllBytes));
    if (parts.back().enough) break;
    if (wanted.tail >= 0) wanted.tail -= static_cast<int>(parts.back().lines.size());
  }
  for (auto part = parts.rbegin(); part != parts.rend(); ++part) {
    std::ranges::move(part->lines, std::back_inserter(lines));
  }
}

void in_order(std::vector<StoredLine>& lines, int tail) {
  std::stable_sort(lines.begin(), lines.end(), [](const auto& a, const auto& b) { return a.time < b.time; });
  if (tail >= 0 && lines.size() > static_cast<std::size_t>(tail)) lines.erase(lines.begin(), lines.end() - tail);
}

}  // namespace splatbus::cli
