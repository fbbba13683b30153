#include "world/world.h"

#include <gtest/gtest.h>
#include <poll.h>

#include <algorithm>
#include <csignal>
#include <cstring>
#include <fstream>
#include <set>
#include <string>

#include "command.h"
#include "pipeline.h"

namespace splatbus::cli {
namespace {

namespace fs = std::filesystem;

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

std::set<std::uint64_t> ids_in(const fs::path& folder) {
  std::set<std::uint64_t> ids;
  world::World world(folder);
  EXPECT_TRUE(world.damage().empty());
  for (const auto& [key, entry] : world.pages()) {
    const auto page = world.read(key);
    if (!page) continue;
    for (std::uint32_t lane = 0; lane < page->count; ++lane) {
      std::uint64_t id = 0;
      std::memcpy(&id, page->words.data() + std::size_t{89} * page->count + std::size_t{2} * lane, sizeof(id));
      EXPECT_TRUE(ids.insert(id).second) << "Gaussian " << id << " is there twice";
    }
  }
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

}  // namespace
}  // namespace splatbus::cli
