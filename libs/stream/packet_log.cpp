#include "stream/packet_log.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <stdexcept>
#include <utility>

#include "stream/layout.h"

namespace splatbus::stream {

namespace {

constexpr std::size_t kLengths = 8;

}  // namespace

PacketLog::PacketLog(std::string path) : path_(std::move(path)), file_(path_, std::ios::binary | std::ios::trunc) {
  if (!file_) throw std::runtime_error(fmt::format("{}: cannot be written", path_));
}

void PacketLog::add(std::span<const std::uint8_t> packet, std::span<const std::uint8_t> payload) {
  std::array<char, kLengths> lengths{};
  for (std::size_t i = 0; i < 4; ++i) {
    lengths[i] = static_cast<char>(packet.size() >> (8 * i));
    lengths[4 + i] = static_cast<char>(payload.size() >> (8 * i));
  }
  file_.write(lengths.data(), lengths.size());
  for (const auto part : {packet, payload}) {
    file_.write(reinterpret_cast<const char*>(part.data()), static_cast<std::streamsize>(part.size()));
  }
  file_.flush();
  if (!file_) throw std::runtime_error(fmt::format("{}: cannot be written any further", path_));
}

PacketLogReader::PacketLogReader(std::string path) : path_(std::move(path)), file_(path_, std::ios::binary) {
  file_.seekg(0, std::ios::end);
  left_ = static_cast<std::size_t>(std::max<std::streamoff>(0, file_.tellg()));
  file_.seekg(0);
  if (!file_) throw std::runtime_error(fmt::format("{}: cannot be read", path_));
}

std::optional<LoggedMessage> PacketLogReader::next() {
  Bytes lengths(kLengths);
  if (!file_.read(reinterpret_cast<char*>(lengths.data()), kLengths)) return std::nullopt;
  ByteReader reader(lengths, path_);
  LoggedMessage message;
  const std::size_t packet = reader.u32(), payload = reader.u32();
  if (packet > kMaxPacketBytes || payload > kMaxPayloadBytes) {
    throw std::runtime_error(fmt::format("{}: a message of {} and {} bytes: not a packet log", path_, packet, payload));
  }
  // Before there is memory for it.
  if (packet + payload + kLengths > left_) return std::nullopt;
  left_ -= packet + payload + kLengths;
  for (auto [bytes, size] : {std::pair{&message.packet, packet}, std::pair{&message.payload, payload}}) {
    bytes->resize(size);
    if (!file_.read(reinterpret_cast<char*>(bytes->data()), static_cast<std::streamsize>(size))) return std::nullopt;
  }
  return message;
}

}  // namespace splatbus::stream
