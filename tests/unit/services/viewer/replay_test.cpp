#include "viewer/replay.h"

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <opencv2/core.hpp>
#include <utility>

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
  const auto picture = [&](const std::string& name, std::uint64_t k) {
    return metrics::read_png((folder_ / name / fmt::format("frame_{:06}.png", k)).string());
  };
  for (const auto& [name, draw] :
       {std::pair<std::string, gl::Draw>{"gl", gl::Draw::Quads}, {"tiles", gl::Draw::Tiles}}) {
    Options asked = options(name, true);
    asked.draw = draw;
    EXPECT_EQ(replay(log(), asked, Device::Cpu, {}), drawn);
    for (std::uint64_t k = 0; k < drawn; ++k) {
      const metrics::Quality quality = metrics::compare(picture(name, k), picture("cpu", k));
      EXPECT_GE(quality.psnr_db, 45) << name << " " << k;
      EXPECT_GE(quality.ssim, 0.998) << name << " " << k;
    }
  }
  EXPECT_GT(cv::norm(picture("tiles", 0), picture("gl", 0), cv::NORM_INF), 0) << "rounded otherwise";
  EXPECT_LT(metrics::compare(picture("gl", 0), picture("gl", drawn - 1)).psnr_db, 40)
      << "the camera and the model have moved";
}

TEST_F(Replay, SaysWhatItLacks) {
  write_log();
  Options nowhere;
  EXPECT_THROW(replay(log(), nowhere, Device::Cpu, {}), bus::Error);
  EXPECT_THROW(replay((folder_ / "none").string(), options("cpu", false), Device::Cpu, {}), std::runtime_error);
}

}  // namespace
}  // namespace splatbus::viewer
