#pragma once

#include <cstdint>
#include <filesystem>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "log_store.h"

namespace splatbus::cli {

// The files of LogStore as they are read: of each process one that is written to, and those before it.

struct Extent {
  std::string since;  ///< nothing older
  int tail = -1;      ///< >= 0: so many of the last are enough
};

inline constexpr std::uintmax_t kAllBytes = std::numeric_limits<std::uintmax_t>::max();

[[nodiscard]] std::filesystem::path current_file(const std::filesystem::path& folder, const std::string& process);

/// The current file and those before it, newest first.
[[nodiscard]] std::vector<std::filesystem::path> files_of(const std::filesystem::path& folder,
                                                          const std::string& process);

/// "TIME | text", as LogStore writes it.
[[nodiscard]] std::optional<StoredLine> parse_line(const std::string& process, const std::string& line);

/// Of files from the newest to the oldest; of the newest its first bytes.
void read_files(std::span<const std::filesystem::path> files, const std::string& process, Extent wanted,
                std::uintmax_t of_newest, std::vector<StoredLine>& lines);

/// By time; with `tail` >= 0 the last of them only.
void in_order(std::vector<StoredLine>& lines, int tail);

}  // namespace splatbus::cli
