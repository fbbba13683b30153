#pragma once

#include <cstddef>
#include <cstdint>
#include <fstream>
#include <optional>
#include <span>
#include <string>

#include "stream/bytes.h"

namespace splatbus::stream {

/// A file of what a viewer received: of each message u32 length of the packet, u32 length of the payload (little
/// endian), packet, payload. Throws std::runtime_error naming the path when it cannot be written.
class PacketLog {
 public:
  explicit PacketLog(std::string path);
  void add(std::span<const std::uint8_t> packet, std::span<const std::uint8_t> payload);

 private:
  std::string path_;
  std::ofstream file_;
};

struct LoggedMessage {
  Bytes packet, payload;
};

/// Reads a PacketLog. Throws std::runtime_error naming the path for one that cannot be read; a last message that was
/// not written to its end is none.
class PacketLogReader {
 public:
  explicit PacketLogReader(std::string path);
  /// nullopt at the end.
  [[nodiscard]] std::optional<LoggedMessage> next();

 private:
  std::string path_;
  std::ifstream file_;
  std::size_t left_ = 0;  ///< bytes
};

}  // namespace splatbus::stream
