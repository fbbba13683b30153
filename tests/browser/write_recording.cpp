// write_recording FILE FOLDER: a recording of golden messages of FOLDER, one a channel, for programs of others to read.
#include <flatbuffers/flatbuffers.h>
#include <fmt/format.h>

#include <array>
#include <cstring>
#include <exception>
#include <filesystem>
#include <fstream>
#include <iterator>

#include "recording_file.h"
#include "wire/schemas.h"

namespace {

namespace cli = splatbus::cli;
namespace mcap = splatbus::mcap;
namespace fs = std::filesystem;

std::shared_ptr<const cli::Blob> read(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  if (text.empty()) throw std::runtime_error(path.string() + ": cannot be read");
  cli::Blob blob{.data = std::make_unique<std::byte[]>(text.size()), .size = text.size()};
  std::memcpy(blob.data.get(), text.data(), text.size());
  return std::make_shared<const cli::Blob>(std::move(blob));
}

/// As headers say it, of the version that this build has.
std::string header_schema(const std::string& table) {
  for (int version = 1; version < 100; ++version) {
    std::string schema = fmt::format("{}/{}", table, version);
    if (splatbus::wire::find_schema(schema)) return schema;
  }
  throw std::runtime_error(table + ": no such table");
}

void write(const fs::path& path, const fs::path& golden) {
  cli::RecordingFileOptions options;
  options.writer.header = {.profile = "splatbus", .library = "write_recording"};
  options.writer.chunk_bytes = 4096;
  options.metadata = {{.name = cli::kRecordingMetadata, .values = {{"splatbus", "0"}}}};
  options.open = [&](unsigned) { return mcap::create_file(path); };
  cli::RecordingFile file(options);
  std::uint32_t number = 0;
  for (const char* name : {"SceneUpdate", "CaptureReference", "ModelPublished", "Heartbeat", "EngineFrame"}) {
    cli::QueuedMessage message{.topic = fmt::format("golden/{}", name),
                               .schema = header_schema(name),
                               .latched = number % 2 == 0,
                               .latch_key = "",
                               .sequence = ++number,
                               .log_time = 1'700'000'000'000'000'000U + number,
                               .publish_time = 1'600'000'000'000'000'000U + number,
                               .data = read(golden / fmt::format("{}.bin", name))};
    file.write(message);
  }
  cli::TopicRecord missing;
  missing.slow_disk = 3;
  file.close({{"golden/Heartbeat", missing}});
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) return 2;
  try {
    write(argv[1], argv[2]);
    return 0;
  } catch (const std::exception& error) {
    fmt::print(stderr, "write_recording: {}\n", error.what());
    return 1;
  }
}
