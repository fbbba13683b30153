// A recording from anywhere, by its summary or without one, and its messages as those of a bus. Its checksums are taken
// out first, or no change would ever get behind them.
#include "mcap/reader.h"
#include "memory_file.h"
#include "recorded_message.h"

namespace {

namespace mcap = splatbus::mcap;
namespace cli = splatbus::cli;
using splatbus::fuzz::require;
using Raw = std::vector<std::uint8_t>;

void take_out(Raw& bytes, std::size_t at) {
  if (at + 4 <= bytes.size()) std::memset(bytes.data() + at, 0, 4);
}

void take_out_checksums(Raw& bytes) {
  for (std::size_t at = mcap::kMagic.size(); at + mcap::kRecordHeaderBytes < bytes.size();) {
    std::uint64_t length = 0;
    std::memcpy(&length, bytes.data() + at + 1, sizeof(length));
    if (length > bytes.size()) break;
    constexpr std::size_t before_crc = 3 * sizeof(std::uint64_t);
    if (static_cast<mcap::Opcode>(bytes[at]) == mcap::Opcode::Chunk) {
      take_out(bytes, at + mcap::kRecordHeaderBytes + before_crc);
    }
    at += mcap::kRecordHeaderBytes + length;
  }
  const std::size_t end = mcap::kMagic.size() + 4;
  if (bytes.size() >= end) take_out(bytes, bytes.size() - end);
}

void read_message(const mcap::Channel& channel, const mcap::Message& message) {
  try {
    cli::RecordedMessage recorded(channel.topic, message.data);
    const std::byte* const end = message.data.data() + message.data.size();
    for (const auto& tensor : recorded.tensors()) {
      if (tensor.inline_data == nullptr) continue;
      const auto* data = static_cast<const std::byte*>(tensor.inline_data);
      const std::size_t bytes = splatbus::bus::tensor_bytes(tensor.shape, tensor.type);
      require(data >= message.data.data() && bytes <= static_cast<std::size_t>(end - data),
              "tensors lie in the message");
    }
    recorded.shift_scene_version(1'000'000);
  } catch (const splatbus::bus::Error&) {  // refused
  }
}

}  // namespace

SPLATBUS_FUZZ_TARGET(recording, input) {
  Raw bytes(input.begin(), input.end());
  take_out_checksums(bytes);
  const splatbus::fuzz::MemoryFile file(bytes);
  try {
    mcap::Reader reader(file.path(), {.chunk_bytes = 1 << 20, .summary_bytes = 1 << 20});
    (void)reader.summary();
    for (std::size_t chunk = 0; chunk < reader.summary().chunks.size(); ++chunk) {
      try {
        reader.read_chunk(chunk, [&](const mcap::Message& message) {
          read_message(reader.summary().channels.at(message.channel_id), message);
        });
      } catch (const mcap::Error&) {  // refused
      }
    }
    (void)reader.read_metadata();
  } catch (const mcap::Error&) {  // refused
  }
  if (bytes.empty()) return;
  try {
    mcap::recover(file.path(), {.chunk_bytes = 1 << 20, .summary_bytes = 1 << 20});
    require(mcap::Reader(file.path(), {.chunk_bytes = 1 << 20, .summary_bytes = 1 << 26}).damage().empty(),
            "what was recovered is complete");
  } catch (const mcap::Error&) {  // refused
  }
}
