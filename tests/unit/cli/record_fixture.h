#pragma once

#include <gtest/gtest.h>

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "../bus/bus_fixture.h"
#include "mcap/reader.h"
#include "player.h"
#include "recorder.h"

namespace splatbus::cli {

inline RecordingFileOptions to_file(const std::filesystem::path& path) {
  RecordingFileOptions options;
  options.metadata = {{.name = kRecordingMetadata,
                       .values = {{"realtime_minus_monotonic_ns", std::to_string(realtime_minus_monotonic_ns())}}}};
  options.open = [path](unsigned part) {
    return mcap::create_file(part == 0 ? path.string() : path.string() + std::to_string(part));
  };
  return options;
}

class RecordTest : public bus_test::BusTest {
 protected:
  [[nodiscard]] std::filesystem::path path() const { return std::filesystem::path(directory_.path()) / "test.mcap"; }

  std::unique_ptr<Recorder> record(RecorderOptions options = {}) {
    if (!options.file.open) options.file = to_file(path());
    auto recorder = std::make_unique<Recorder>(connect("recorder"), options);
    EXPECT_TRUE(recorder->wait_connected(bus_test::patience));
    return recorder;
  }
  /// Until `topic` has that many messages, dropped ones counted.
  static void poll_until(Recorder& recorder, const std::string& topic, std::uint64_t count) {
    ASSERT_TRUE(bus_test::eventually([&] {
      recorder.poll(std::chrono::milliseconds(1));
      const auto topics = recorder.state().topics;
      const auto found = topics.find(topic);
      return found != topics.end() && found->second.messages + found->second.dropped() >= count;
    }));
  }
};

/// Another bus, on which a recording is played.
class OtherBus {
 public:
  OtherBus() { broker_.start(); }
  std::shared_ptr<bus::Context> connect(const std::string& source) {
    return bus::Context::create(directory_.address(), source);
  }
  PlayState play(const std::filesystem::path& path, const PlayOptions& options) {
    mcap::Reader reader(path);
    Player player(reader, directory_.address(), options);
    return player.run({}, [](const PlayState&) {});
  }

 private:
  bus_test::TemporaryDirectory directory_;
  bus_service::Broker broker_{bus_service::BrokerOptions{.address = directory_.address()}};
};

inline std::vector<float> floats_of(const bus::Message& message) {
  const auto tensor = message.tensor("values");
  if (!tensor) return {};
  std::vector<float> values(tensor->elements());
  return tensor->copy(values.data()) ? values : std::vector<float>();
}

}  // namespace splatbus::cli
