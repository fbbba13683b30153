#include <nlohmann/json.hpp>
#include <utility>

#include "../world/world_fixture.h"
#include "run_verb.h"
#include "splats/file.h"

namespace splatbus::cli {
namespace {

class WorldVerbTest : public world::WorldTest {
 protected:
  /// Pages of 10, 20 and 30 Gaussians of the world around x = 0, 100 and 200, the middle one the youngest.
  void SetUp() override {
    world::World world(folder_, {.note = "a yard"});
    for (std::uint32_t p = 0; p < 3; ++p) {
      world::Page page = make_page(p, 10 * (p + 1), 3);
      page.step = p == 1 ? 9 : p;
      page.bounds = {.low = {100.0F * p - 2, 0, 0}, .high = {100.0F * p + 2, 1, 1}, .max_scale_m = 1};
      put(world, page);
    }
    world.commit({.next_gaussian_id = 10000, .step = 12});
  }

  nlohmann::json run(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), "world");
    return nlohmann::json::parse(run_verb(add_world_verb, std::move(arguments)));
  }
};

TEST_F(WorldVerbTest, InfoSaysWhatThereIs) {
  const auto info = run({"info", folder_, "--json"});
  EXPECT_EQ(info["pages"], 3);
  EXPECT_EQ(info["gaussians"], 60);
  EXPECT_EQ(info["step"], 12);
  EXPECT_EQ(info["note"], "a yard");
  EXPECT_EQ(info["bounds"]["low_m"], nlohmann::json({-2.0, 0.0, 0.0}));
  EXPECT_EQ(info["bounds"]["high_m"], nlohmann::json({202.0, 1.0, 1.0}));
  EXPECT_EQ(info["bytes"], world::read_bytes(segment(1)).size());
  EXPECT_TRUE(info["damage"].empty());
  auto bytes = world::read_bytes(segment(1));
  bytes[32 + 64 + 100] ^= 1;
  world::write_bytes(segment(1), bytes);
  const auto damaged = run({"info", folder_, "--json"});
  EXPECT_EQ(damaged["pages"], 2);
  EXPECT_EQ(damaged["lost_pages"], 1);
  EXPECT_EQ(damaged["damage"].size(), 1U);
}

TEST_F(WorldVerbTest, ExportWritesTheAverages) {
  const std::string path = folder_.parent_path() / "world.ply";
  EXPECT_EQ(run({"export", folder_, path, "--json"})["gaussians"], 60);
  const GaussiansBuffer model = splats::read_file(path).gaussians;
  ASSERT_EQ(model.count(), 60U);
  const world::Page first = make_page(0, 10, 3);
  for (std::uint32_t i = 0; i < 10; ++i) {
    EXPECT_EQ(model.view().plane(0)[i], std::bit_cast<float>(first.words[41 * 10 + i]));
    EXPECT_EQ(model.view().plane(ParameterLayout::kOpacityLogit)[i],
              std::bit_cast<float>(first.words[(41 + ParameterLayout::kOpacityLogit) * 10 + i]));
  }
}

TEST_F(WorldVerbTest, PruneTakesOutWhatIsFarOrOld) {
  EXPECT_EQ(run({"prune", folder_, "--beyond", "10,0,0,150", "--json"})["removed"], 30);
  EXPECT_EQ(world::World(folder_).pages().size(), 2U);
  const std::size_t younger = world::World(folder_).find(make_page(1, 20, 3).key)->bytes;
  EXPECT_EQ(
      run({"prune", folder_, "--max-mb", std::to_string(static_cast<double>(younger + 1) / 1e6), "--json"})["removed"],
      10)
      << "the older of two";
  const world::World left(folder_);
  EXPECT_EQ(left.bytes(), 32 + younger + 64 + 40) << "a page and a commit";
  ASSERT_EQ(left.pages().size(), 1U);
  EXPECT_EQ(left.pages().begin()->second.count, 20U);
  EXPECT_EQ(left.progress().step, 12U);
  EXPECT_THROW(run({"prune", folder_}), std::runtime_error);
  EXPECT_EQ(run({"prune", folder_, "--max-mb", "0.0001", "--json"})["removed"], 20);
  EXPECT_TRUE(world::World(folder_).pages().empty());
}

}  // namespace
}  // namespace splatbus::cli
