#include "viewer/replay.h"

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>

#include "../../stream/toy_server.h"
#include "bus/error.h"
#include "metrics/image_io.h"
#include "metrics/metrics.h"
#include "stream/packet_log.h"

namespace splatbus::viewer {
namespace {

namespace fs = std::filesystem;
using stream::test::ToyServer;

class Replay : public ::testing::Test {
 protected:
  Replay() : folder_(fs::temp_directory_path() / fmt::format("splatbus-replay-{}", ::getpid())) {
    fs::create_directories(folder_);
  }
  ~Replay() override { fs::remove_all(folder_); }

  [[nodiscard]] std::string log() const { return (folder_ / "packets").string(); }
  /// Layout, scene, all pages, and three ticks.
  void write_log() {
    ToyServer server(9, 800);
    server.scene.light.ambient_sh[0] = {0.5F, 0.6F, 0.7F};
    server.scene.light.sun_irradiance = {2, 2, 2};
    server.change_scene();
    stream::PacketLog log(this->log());
    const auto add = [&](const stream::EncodedPacket& packet) { log.add(packet.packet, packet.payload); };
    add(server.stream.layout_packet());
    add(*server.stream.scene_packet());
    for (const auto& packet : server.stream.manifest_packets(*server.stream.offered(), {}, true)) add(packet);
    for (const stream::OfferedPage& page : *server.stream.offered()) {
      for (const stream::PagePacket& part : server.stream.page_packets(page.page)) add(part.packet);
    }
    for (int tick = 0; tick < 3; ++tick) {
      server.train(0.02F);
      for (const auto& packet : server.tick()) add(packet);
    }
  }
  [[nodiscard]] Options options(const std::string& name, bool opengl) const {
    Options options;
    options.out = (folder_ / name).string();
    options.frames = 1;
    options.opengl = opengl;
    options.path.width = options.path.height = 128;
    return options;
  }

  fs::path folder_;
};

TEST_F(Replay, DrawsTheSameThroughOpenGlAsOnTheCpu) {
  write_log();
  const std::uint64_t drawn = replay(log(), options("cpu", false), Device::Cpu, {});
  EXPECT_GT(drawn, 3U);
  EXPECT_EQ(replay(log(), options("gl", true), Device::Cpu, {}), drawn);
  for (std::uint64_t k = 0; k < drawn; ++k) {
    const std::string name = fmt::format("frame_{:06}.png", k);
    const metrics::Quality quality = metrics::compare(metrics::read_png((folder_ / "gl" / name).string()),
                                                      metrics::read_png((folder_ / "cpu" / name).string()));
    EXPECT_GE(quality.psnr_db, 45) << name;
    EXPECT_GE(quality.ssim, 0.998) << name;
  }
  const auto first = metrics::read_png((folder_ / "gl" / "frame_000000.png").string());
  const auto last = metrics::read_png((folder_ / "gl" / fmt::format("frame_{:06}.png", drawn - 1)).string());
  EXPECT_LT(metrics::compare(first, last).psnr_db, 40) << "the camera and the model have moved";
}

TEST_F(Replay, SaysWhatItLacks) {
  write_log();
  Options nowhere;
  EXPECT_THROW(replay(log(), nowhere, Device::Cpu, {}), bus::Error);
  EXPECT_THROW(replay((folder_ / "none").string(), options("cpu", false), Device::Cpu, {}), std::runtime_error);
}

}  // namespace
}  // namespace splatbus::viewer
