#include "world/world.h"

#include <gtest/gtest.h>
#include <poll.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <csignal>
#include <cstring>
#include <deque>
#include <fstream>
#include <glm/glm.hpp>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>

#include "bus/clock.h"
#include "command.h"
#include "model/channels.h"
#include "pipeline.h"
#include "verbs.h"
#include "viewer_watch.h"

namespace splatbus::cli {
namespace {

namespace fs = std::filesystem;

/// A viewer walks from the world's crossing; WALK is the file of its way.
constexpr const char* kWalkFile = R"(
world: yard
services:
  - name: bus
  - name: engine
    program: splatbus-engine-sim
    args: [--scene, world]
  - name: capture-bridge
    parameters: {input_cameras: 8, input_size: 48, sample_budget: 6000, reference_cameras: 2, reference_size: 48}
  - name: expander
  - name: trainer
  - name: relight
  - name: streamer
  - name: viewer
    parameters: {path: walk, path_file: "WALK", speed_m_s: 1.4, width: 48, height: 48, probe: true, probe_period_s: 0}
)";

constexpr const char* kLaunchFile = R"(
world: yard
services:
  - name: bus
  - name: engine
    program: splatbus-engine-sim
  - name: capture-bridge
    parameters: {input_cameras: 6, input_size: 64, sample_budget: 4000, reference_cameras: 2, reference_size: 48}
  - name: expander
  - name: trainer
  - name: relight
)";

/// Where a Gaussian was seen, and how far apart the samples about it were as far as its size says.
struct Seen {
  glm::vec3 point, normal;
  float spacing_m = 0;
};

std::map<std::uint64_t, Seen> gaussians_in(const fs::path& folder) {
  using model::Channel;
  constexpr float kInitialScale = 0.42F;  // of the spacing, until it trains
  std::map<std::uint64_t, Seen> gaussians;
  world::World world(folder);
  EXPECT_TRUE(world.damage().empty());
  for (const auto& [key, entry] : world.pages()) {
    const auto page = world.read(key);
    if (!page) continue;
    const auto row = [&](std::uint32_t number) { return page->words.data() + std::size_t{number} * page->count; };
    const auto value = [&](std::uint32_t number, std::uint32_t lane) {
      return std::bit_cast<float>(row(number)[lane]);
    };
    const auto vector = [&](std::uint32_t first, std::uint32_t lane) {
      return glm::vec3(value(first, lane), value(first + 1, lane), value(first + 2, lane));
    };
    const auto first = [&](Channel channel) { return model::rows_of(channel, world.layout()).first; };
    for (std::uint32_t lane = 0; lane < page->count; ++lane) {
      std::uint64_t id = 0;
      std::memcpy(&id, row(first(Channel::GaussianId)) + std::size_t{2} * lane, sizeof(id));
      const Seen seen{.point = vector(first(Channel::SurfacePoint), lane),
                      .normal = vector(first(Channel::Normal), lane),
                      .spacing_m = std::exp(value(ParameterLayout::kLogScale, lane)) / kInitialScale};
      EXPECT_TRUE(gaussians.emplace(id, seen).second) << "Gaussian " << id << " is there twice";
    }
  }
  return gaussians;
}

std::set<std::uint64_t> ids_in(const fs::path& folder) {
  std::set<std::uint64_t> ids;
  for (const auto& [id, seen] : gaussians_in(folder)) ids.insert(id);
  return ids;
}

/// Everything dies at once; what is started on the same folder begins with the same Gaussians, and the engine's further
/// pictures of the same scene put nothing in twice.
TEST(World, EverythingKilledAndStartedAgainGoesOnWithTheSameWorld) {
  const PrivateBusFolder folder;
  const fs::path file = folder.path() / "test.yaml", world = folder.path() / "yard";
  std::ofstream(file) << kLaunchFile;
  std::set<pid_t> processes;
  {
    const PrivateBusFolder bus;
    ChildProcess launched(std::string(SPLATBUS_BIN_DIR) + "/splatbus",
                          {"launch", file.string(), "--json", "--bus", bus.address().text()}, test_environment());
    std::size_t gaussians = 0;
    while (gaussians < 2000) {
      pollfd output{.fd = launched.output_fd(), .events = POLLIN, .revents = 0};
      poll(&output, 1, 200);
      for (const std::string& line : launched.read_lines(true)) {
        const auto json = nlohmann::json::parse(line, nullptr, false);
        if (json.is_object() && json.value("event", "") == "started") processes.insert(json.at("pid").get<pid_t>());
      }
      ASSERT_FALSE(launched.poll_exit());
      if (!fs::exists(world / "world.splatbus")) continue;
      gaussians = 0;
      for (const auto& [key, page] : world::World(world).pages()) gaussians += page.count;
    }
    ASSERT_EQ(processes.size(), 6U);
    ::kill(launched.pid(), SIGKILL);
    for (const pid_t process : processes) ::kill(process, SIGKILL);
  }
  const std::set<std::uint64_t> before = ids_in(world);
  ASSERT_GE(before.size(), 2000U);

  // Nothing trains and nothing is carved, so that nobody goes.
  const Answer again =
      splatbus_command({"launch", file.string(), "--json", "--seconds", "12", "--set", "trainer.paused=true", "--set",
                        "trainer.carve=false", "--bus", folder.address().text()});
  EXPECT_TRUE(again.status.success());
  const auto says = [&](const std::string& text) {
    return std::any_of(again.lines.begin(), again.lines.end(),
                       [&](const std::string& line) { return line.find(text) != std::string::npos; });
  };
  EXPECT_TRUE(says("world: " + std::to_string(before.size()) + " Gaussians"));
  EXPECT_TRUE(says("adopted a model: " + std::to_string(before.size()) + " points"));
  const std::set<std::uint64_t> after = ids_in(world);
  EXPECT_TRUE(std::includes(after.begin(), after.end(), before.begin(), before.end()));
  EXPECT_LE(after.size(), before.size() * 103 / 100);
}

std::string engines_walk() {
  ChildProcess engine(std::string(SPLATBUS_BIN_DIR) + "/splatbus-engine-sim", {"--scene", "world", "--print-walk"},
                      test_environment());
  std::string text;
  const auto take = [&](bool rest) {
    for (const std::string& line : engine.read_lines(rest)) text += line + "\n";
  };
  while (!engine.poll_exit()) {
    pollfd ready[] = {{engine.exit_fd(), POLLIN, 0}, {engine.output_fd(), POLLIN, 0}};
    poll(ready, 2, -1);
    take(false);
  }
  take(true);
  return text;
}

/// As above, in the middle of a walk through a world, with viewer and streamer. Who walks there again finds all that
/// was committed, sees it anew and beyond, and nothing is put in where something is.
TEST(World, AWalkThatIsKilledGoesOnInTheSameWorld) {
  constexpr float kWalked_m = 4;
  constexpr std::size_t kLeastGaussians = 3000;
  const PrivateBusFolder folder;
  const fs::path file = folder.path() / "test.yaml", world = folder.path() / "yard", way = folder.path() / "walk.txt";
  std::ofstream(way) << engines_walk();
  std::string launch = kWalkFile;
  launch.replace(launch.find("WALK"), 4, way.string());
  std::ofstream(file) << launch;
  std::uint64_t told_step = 0;  // of the trainer, a while before it died
  {
    const PrivateBusFolder bus;
    ChildProcess launched(std::string(SPLATBUS_BIN_DIR) + "/splatbus",
                          {"launch", file.string(), "--json", "--bus", bus.address().text()}, test_environment());
    const auto context = connect_later(bus.address());
    PipelineWatch pipeline(context);
    ViewerWatch viewers(context);
    std::optional<glm::vec3> start;
    std::set<pid_t> processes;
    std::deque<std::pair<std::int64_t, std::uint64_t>> steps;  // CLOCK_MONOTONIC, as they were told
    float walked_m = 0;
    std::size_t kept = 0;
    while (walked_m < kWalked_m || kept < kLeastGaussians) {
      pipeline.poll(std::chrono::milliseconds(100));
      viewers.poll(std::chrono::milliseconds(0));
      for (const std::string& line : launched.read_lines(true)) {
        const auto json = nlohmann::json::parse(line, nullptr, false);
        if (json.is_object() && json.value("event", "") == "started") processes.insert(json.at("pid").get<pid_t>());
      }
      ASSERT_FALSE(launched.poll_exit());
      steps.emplace_back(bus::now_ns(), pipeline.state().trainer.step);
      constexpr std::int64_t kBefore_ns = 5'000'000'000;  // twice what may be lost, for a machine that is busy
      while (steps.size() > 1 && steps[1].first < bus::now_ns() - kBefore_ns) steps.pop_front();
      if (const ViewerWatch::Pose* pose = viewers.pose("viewer")) {
        if (!start) start = pose->camera.world_from_camera.translation;
        walked_m = glm::distance(*start, pose->camera.world_from_camera.translation);
      }
      if (walked_m < kWalked_m || !fs::exists(world / "world.splatbus")) continue;
      kept = 0;
      for (const auto& [key, page] : world::World(world).pages()) kept += page.count;
    }
    ASSERT_EQ(processes.size(), 8U);
    if (steps.front().first < bus::now_ns() - 5'000'000'000) told_step = steps.front().second;
    ::kill(launched.pid(), SIGKILL);
    for (const pid_t process : processes) ::kill(process, SIGKILL);
  }
  EXPECT_GE(world::World(world).progress().step, told_step);
  const std::map<std::uint64_t, Seen> before = gaussians_in(world);
  ASSERT_GE(before.size(), kLeastGaussians);

  const Answer again =
      splatbus_command({"launch", file.string(), "--json", "--seconds", "20", "--set", "trainer.paused=true", "--set",
                        "trainer.carve=false", "--bus", folder.address().text()});
  EXPECT_TRUE(again.status.success());
  const std::map<std::uint64_t, Seen> after = gaussians_in(world);
  EXPECT_GT(after.size(), before.size()) << "the walk goes on to where it has not been";
  std::size_t missing = 0, twice = 0;
  for (const auto& [id, seen] : before) missing += after.contains(id) ? 0 : 1;
  EXPECT_EQ(missing, 0U);
  // Nothing new covers what was there: it is as far away as the expander's fill_distance says.
  for (const auto& [id, seen] : after) {
    if (before.contains(id)) continue;
    const float least_m = 0.74F * seen.spacing_m;
    twice += std::any_of(before.begin(), before.end(),
                         [&](const auto& old) {
                           return glm::distance(old.second.point, seen.point) < least_m &&
                                  glm::dot(old.second.normal, seen.normal) > 0.51F;
                         })
                 ? 1
                 : 0;
  }
  EXPECT_EQ(twice, 0U);
}

}  // namespace
}  // namespace splatbus::cli
