#include "splats/file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <stdexcept>

#include "../gaussians/random.h"

namespace splatbus::splats {
namespace {

using ::testing::HasSubstr;
using ::testing::ThrowsMessage;

GaussiansBuffer random_model(std::size_t count) {
  test::Random random(90);
  GaussiansBuffer model = random.gaussians({Appearance::Radiance, 1}, count);
  model.object_id.assign(count, kWorldFrame);
  return model;
}

TEST(SplatFiles, AreWrittenByTheEndOfTheNameAndReadByTheirBeginning) {
  const test::TemporaryFolder folder;
  const GaussiansBuffer model = random_model(7);
  for (const char* name : {"model.ply", "model.spz"}) {
    const std::string path = folder.file(name), other = folder.file("moved");
    EXPECT_EQ(write_file(path, model.view(), {}), 7U);
    EXPECT_FALSE(std::filesystem::exists(path + ".partial"));
    std::filesystem::rename(path, other);
    const SplatFile file = read_file(other);
    EXPECT_EQ(file.gaussians.count(), 7U) << name;
    EXPECT_TRUE(file.mip);
    EXPECT_NEAR(file.gaussians.parameters[3], model.parameters[3], 0.51 / 4096);
  }
  EXPECT_EQ(write_file(folder.file("old.spz"), model.view(), {}, {.spz_version = 3}), 7U);
  EXPECT_EQ(std::ifstream(folder.file("old.spz")).get(), 0x1F);
  EXPECT_EQ(write_file(folder.file("model.glb"), model.view(), {}), 7U);
  EXPECT_EQ(std::ifstream(folder.file("model.glb")).get(), 'g');
}

TEST(SplatFiles, CountWhatIsWritten) {
  const test::TemporaryFolder folder;
  GaussiansBuffer model = random_model(7);
  model.object_id[2] = 5;  // which the scene does not have
  EXPECT_EQ(write_file(folder.file("model.ply"), model.view(), {}), 6U);
  EXPECT_EQ(read_file(folder.file("model.ply")).gaussians.count(), 6U);
}

TEST(SplatFiles, ErrorsNameTheFile) {
  const test::TemporaryFolder folder;
  const GaussiansBuffer model = random_model(1), none = random_model(0);
  const auto expect_refused = [](const std::string& path, const GaussiansBuffer& what, const std::string& reason) {
    EXPECT_THAT([&] { write_file(path, what.view(), {}); },
                ThrowsMessage<std::runtime_error>(HasSubstr(path + ": " + reason)));
  };
  expect_refused("/no/such/folder/model.ply", model, "cannot be written: No such file or directory");
  expect_refused(folder.file("model.sog"), model, ".ply, .glb and .spz can be written");
  expect_refused(folder.file("model.glb"), none, "cannot be written: a .glb file cannot hold a model without");
  EXPECT_TRUE(std::filesystem::is_empty(std::filesystem::path(folder.file("x")).parent_path())) << "nothing half done";
}

}  // namespace
}  // namespace splatbus::splats
