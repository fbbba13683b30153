#include "viewer/path_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>

#include "../../bus/bus_fixture.h"
#include "bus/error.h"

namespace splatbus::viewer {
namespace {

class PathFileTest : public testing::Test {
 protected:
  std::string write(const std::string& text) {
    const std::string file = directory_.path() + "/way.txt";
    std::ofstream(file) << text;
    return file;
  }
  /// What reading it is refused with.
  template <class Read>
  std::string refusal(Read read, const std::string& text) {
    try {
      static_cast<void>(read(write(text)));
    } catch (const bus::Error& error) {
      return error.what();
    }
    return "";
  }
  bus_test::TemporaryDirectory directory_;
};

TEST_F(PathFileTest, ReadsPointsByLeg) {
  const auto legs = read_path_points(write("# a way\n1 2 3\n\n-4.5 0 1e1  # far\nteleport\n7 8 9\n"));
  ASSERT_EQ(legs.size(), 2U);
  EXPECT_EQ(legs[0], (PathLeg{{1, 2, 3}, {-4.5F, 0, 10}}));
  EXPECT_EQ(legs[1], (PathLeg{{7, 8, 9}}));
}

TEST_F(PathFileTest, RefusesByFileAndLine) {
  using testing::EndsWith;
  using testing::HasSubstr;
  const auto points = [&](const std::string& text) { return refusal(read_path_points, text); };
  EXPECT_THAT(points("0 0 0\n1 2\n"), EndsWith("way.txt:2: 2 words where 'x y z' or 'teleport' belongs"));
  EXPECT_THAT(points("0 0 0\n\n1 2 3m\n"), EndsWith("way.txt:3: '3m' is not a number"));
  EXPECT_THAT(points("0 0 0\n1 nan 3\n"), HasSubstr("way.txt:2: "));
  EXPECT_THAT(points("0 0 1e9\n"), HasSubstr("way.txt:1: "));
  EXPECT_THAT(points("teleport\n0 0 0\n"), EndsWith("way.txt:1: a teleport from nowhere"));
  EXPECT_THAT(points("0 0 0\nteleport\nteleport\n1 1 1\n"), EndsWith("way.txt:3: a teleport from nowhere"));
  EXPECT_THAT(points("0 0 0\nteleport\n"), EndsWith("way.txt:2: a teleport to nowhere"));
  EXPECT_THAT(points("# nothing\n"), EndsWith("way.txt: it holds no point"));
  EXPECT_THAT(points("0 0 0 0 1 0 0 0\n"), HasSubstr("way.txt:1: 8 words"));
  const auto poses = [&](const std::string& text) { return refusal(read_path_poses, text); };
  EXPECT_THAT(poses("0 0 0\n"), EndsWith("way.txt:1: 3 words where 't x y z qw qx qy qz' or 'teleport' belongs"));
  EXPECT_THAT(poses("0 0 0 0 1 0 0 0\n0 1 0 0 1 0 0 0\n"), EndsWith("way.txt:2: 0 s comes after 0 s"));
  EXPECT_THAT(poses("0 0 0 0 0.5 0 0 0\n"), EndsWith("way.txt:1: a quaternion of length 0.5"));
  EXPECT_THROW(static_cast<void>(read_path_points(directory_.path() + "/none")), bus::Error);
}

TEST_F(PathFileTest, ReadsWhatWasRecorded) {
  const std::string file = directory_.path() + "/recorded.txt";
  const glm::quat turned = glm::angleAxis(1.0F, glm::normalize(glm::vec3(1, 2, 3)));
  {
    PathRecorder recorder(file);
    recorder.add({.time_s = 0.5, .world_from_camera = {.rotation = {1, 0, 0, 0}, .translation = {1, 2, 3}}});
    recorder.add({.time_s = 0.5, .world_from_camera = {}});
    recorder.add({.time_s = 0.75, .world_from_camera = {.rotation = turned, .translation = {-200.125F, 0, 4}}});
  }
  const auto legs = read_path_poses(file);
  ASSERT_EQ(legs.size(), 1U);
  ASSERT_EQ(legs[0].size(), 2U);
  EXPECT_EQ(legs[0][0].time_s, 0.5);
  EXPECT_EQ(legs[0][1].time_s, 0.75);
  EXPECT_EQ(legs[0][0].world_from_camera.translation, glm::vec3(1, 2, 3));
  EXPECT_NEAR(legs[0][1].world_from_camera.translation.x, -200.125F, 1e-4F);
  EXPECT_NEAR(std::abs(glm::dot(legs[0][1].world_from_camera.rotation, turned)), 1, 1e-6F);
  EXPECT_THROW(PathRecorder("/nowhere/at/all"), bus::Error);
}

}  // namespace
}  // namespace splatbus::viewer
