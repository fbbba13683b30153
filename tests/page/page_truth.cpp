// What the page has to show of a stream.
//   page_truth render LOG FOLDER      draws the log's model at three times from six cameras as the native viewer does:
//                                     FOLDER/truth_TIME_CAMERA.png and FOLDER/views.json, which says where from
//   page_truth compare FOLDER NAME    compares FOLDER/NAME_TIME_CAMERA.png with them
//   page_truth quality PICTURE REFERENCE WIDTH HEIGHT   of two files of RGBA, as JSON
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>
#include <vector>

#include "gaussians/camera.h"
#include "metrics/image_io.h"
#include "metrics/metrics.h"
#include "raster/model_renderer.h"
#include "stream/display_gaussians.h"
#include "stream/follower.h"
#include "stream/packet_log.h"

namespace {

namespace fs = std::filesystem;
using namespace splatbus;

constexpr std::uint32_t kSide = 256;
constexpr int kCameras = 6, kTimes = 3;
constexpr double kLeastPsnr = 45, kLeastSsim = 0.998, kMostFlip = 0.01;

Camera camera_of(int index) {
  const float turn = 1.1F * static_cast<float>(index), far = 2.5F + 0.6F * static_cast<float>(index);
  const glm::vec3 eye(far * std::cos(turn), 0.4F + 0.5F * static_cast<float>(index), far * std::sin(turn));
  return look_at(eye, {0, 0.2F, 0}, kSide, kSide, 0.9F);
}

/// As the page's poses are: view_from_world, fx, fy, cx, cy, width, height.
std::vector<float> pose_of(const Camera& camera) {
  const Rigid view_from_world = inverse(camera.world_from_camera);
  const glm::mat3 rotation = glm::mat3_cast(view_from_world.rotation);
  std::vector<float> pose;
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) pose.push_back(rotation[column][row]);
    pose.push_back(view_from_world.translation[row]);
  }
  pose.insert(pose.end(), {0, 0, 0, 1, camera.fx, camera.fy, camera.cx, camera.cy, static_cast<float>(camera.width),
                           static_cast<float>(camera.height)});
  return pose;
}

std::string picture(std::string_view name, int time, int camera) {
  return fmt::format("{}_{}_{}.png", name, time, camera);
}

void render(const std::string& log, const fs::path& folder) {
  fs::create_directories(folder);
  std::vector<stream::LoggedMessage> messages;
  for (stream::PacketLogReader reader(log); auto message = reader.next();) messages.push_back(std::move(*message));
  stream::Follower follower({.name = "truth"}, 0);
  stream::DisplayGaussians display;
  const auto renderer = raster::make_model_renderer(Device::Cpu);
  raster::Render drawn;
  nlohmann::json views{{"times", nlohmann::json::array()}, {"poses", nlohmann::json::array()}};
  for (int camera = 0; camera < kCameras; ++camera) views["poses"].push_back(pose_of(camera_of(camera)));
  std::size_t received = 0;
  for (int time = 0; time < kTimes; ++time) {
    const std::size_t until = messages.size() * static_cast<std::size_t>(time + 2) / (kTimes + 1);
    for (; received < until; ++received) follower.receive(messages[received].packet, messages[received].payload, 0);
    views["times"].push_back(until);
    display.apply(follower.replica().take_changes());
    const SceneState scene = follower.replica().scene();
    const GaussiansView gaussians = display.view(scene.light.sources);
    renderer->read_in_place(gaussians);
    for (int camera = 0; camera < kCameras; ++camera) {
      renderer->draw(camera_of(camera), scene, {}, drawn);
      const bool linear = gaussians.layout.appearance == Appearance::Transfer;
      metrics::write_png(folder / picture("truth", time, camera),
                         metrics::from_planes(drawn.color.data.data(), kSide, kSide, linear));
    }
  }
  std::ofstream(folder / "views.json") << views;
}

bool compare(const fs::path& folder, std::string_view name) {
  metrics::Quality worst{.psnr_db = 1e9, .ssim = 1, .flip = 0};
  for (int time = 0; time < kTimes; ++time) {
    for (int camera = 0; camera < kCameras; ++camera) {
      const metrics::Quality quality = metrics::compare(metrics::read_png(folder / picture(name, time, camera)),
                                                        metrics::read_png(folder / picture("truth", time, camera)));
      worst.psnr_db = std::min(worst.psnr_db, quality.psnr_db);
      worst.ssim = std::min(worst.ssim, quality.ssim);
      worst.flip = std::max(worst.flip, quality.flip);
    }
  }
  fmt::print("{}: PSNR at least {:.2f} dB, SSIM {:.5f}, FLIP at most {:.5f}\n", name, worst.psnr_db, worst.ssim,
             worst.flip);
  return worst.psnr_db >= kLeastPsnr && worst.ssim >= kLeastSsim && worst.flip <= kMostFlip;
}

std::vector<std::uint8_t> read_bytes(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

void print_quality(const fs::path& picture, const fs::path& reference, std::uint32_t width, std::uint32_t height) {
  const auto image_of = [&](const fs::path& path) {
    return metrics::from_rgba(read_bytes(path).data(), width, height);
  };
  const metrics::Quality quality = metrics::compare(image_of(picture), image_of(reference));
  fmt::print("{}\n", nlohmann::json{{"ssim", quality.ssim}, {"flip", quality.flip}}.dump());
}

}  // namespace

int main(int argc, char** argv) {
  const std::vector<std::string> arguments(argv + 1, argv + argc);
  if (arguments.size() == 3 && arguments[0] == "render") {
    render(arguments[1], arguments[2]);
    return 0;
  }
  if (arguments.size() == 3 && arguments[0] == "compare") return compare(arguments[1], arguments[2]) ? 0 : 1;
  if (arguments.size() == 5 && arguments[0] == "quality") {
    const auto side = [&](std::size_t k) { return static_cast<std::uint32_t>(std::stoul(arguments[k])); };
    print_quality(arguments[1], arguments[2], side(3), side(4));
    return 0;
  }
  std::fputs(
      "usage: page_truth render LOG FOLDER | page_truth compare FOLDER NAME |\n"
      "       page_truth quality PICTURE REFERENCE WIDTH HEIGHT\n",
      stderr);
  return 2;
}
