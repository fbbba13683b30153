#include "explore_way.h"

#include <gtest/gtest.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmath>
#include <csignal>
#include <cstring>
#include <fstream>
#include <glm/gtc/constants.hpp>

#include "../bus/bus_fixture.h"
#include "process_memory.h"
#include "viewer/walk_path.h"

namespace splatbus::cli {
namespace {

// 100 m along +x, then 100 m along +z.
const viewer::PathLeg kWay{{0, 1.6F, 0}, {100, 1.6F, 0}, {100, 1.6F, 100}};

Camera at(float x) {
  Camera camera;
  camera.world_from_camera.translation = {x, 0, 0};
  return camera;
}

TEST(ExploreWay, GoesOutComesBackAPartAndJumpsToTheStart) {
  const ExploreWay way(kWay, 20, 60, 40, 1.4);
  EXPECT_NEAR(way.out_s(), 60, 1e-4);
  EXPECT_NEAR(way.walk_s(), 100, 1e-4);
  EXPECT_EQ(way.phase(59), ExplorePhase::Out);
  EXPECT_EQ(way.phase(61), ExplorePhase::Back);
  EXPECT_EQ(way.phase(101), ExplorePhase::Teleported);

  // What a viewer makes of the file.
  const bus_test::TemporaryDirectory directory;
  const std::string file = directory.path() + "/way.txt";
  std::ofstream(file) << way.path_text();
  const viewer::WalkPath walk(viewer::read_path_points(file), {.speed_m_s = 1.4});
  EXPECT_LT(glm::distance(walk.at(0).eye, {20, 1.6F, 0}), 1e-3F);
  EXPECT_LT(glm::distance(walk.at(60).eye, {100, 1.6F, 4}), 0.02F) << "84 m on";
  EXPECT_LT(glm::distance(walk.at(90).eye, {62, 1.6F, 0}), 0.02F) << "42 m back";
  EXPECT_LT(glm::distance(walk.at(99.9).eye, {48.14F, 1.6F, 0}), 0.02F) << "56 m back";
  EXPECT_LT(glm::distance(walk.at(100.1).eye, {20, 1.6F, 0}), 0.02F);
  EXPECT_LT(glm::distance(walk.at(100.1).forward(), {1, 0, 0}), 1e-3F) << "as at the beginning";
}

TEST(ExploreWay, TurnsWhereTheWayEnds) {
  const ExploreWay way(kWay, 150, 300, 20, 1);
  EXPECT_NEAR(way.out_s(), 50, 1e-4);
  EXPECT_NEAR(way.walk_s(), 70, 1e-3);
  EXPECT_THROW(ExploreWay(kWay, 199.5, 300, 20, 1), std::runtime_error);
}

TEST(Stations, AreJudgedOnceFromTheSameDistanceBothWays) {
  Stations stations;
  std::vector<std::pair<float, std::size_t>> left, back;
  for (float x = 0; x < 20.5F; x += 1) {
    for (const std::size_t station : stations.pass(ExplorePhase::Out, at(x))) {
      left.emplace_back(x, station);
      stations.judge(station, ExplorePhase::Out, 0.9 + 0.01 * static_cast<double>(station));
    }
  }
  ASSERT_EQ(stations.all().size(), 5U) << "every 5 m";
  EXPECT_EQ(left, (std::vector<std::pair<float, std::size_t>>{{8.0F, 0}, {13.0F, 1}, {18.0F, 2}}));
  for (float x = 20; x > 6.5F; x -= 1) {
    for (const std::size_t station : stations.pass(ExplorePhase::Back, at(x))) {
      back.emplace_back(x, station);
      stations.judge(station, ExplorePhase::Back, 0.8);
    }
  }
  EXPECT_EQ(back, (std::vector<std::pair<float, std::size_t>>{{18.0F, 2}, {13.0F, 1}, {8.0F, 0}}));
  const auto means = stations.means();
  ASSERT_TRUE(means);
  EXPECT_EQ(means->stations, 3U);
  EXPECT_NEAR(means->left, 0.91, 1e-9);
  EXPECT_NEAR(means->back, 0.8, 1e-9);
  EXPECT_TRUE(stations.pass(ExplorePhase::Teleported, at(0)).empty());
}

TEST(Stations, WithoutAWayBackThereAreNoMeans) {
  Stations stations;
  for (float x = 0; x < 20; x += 1) {
    for (const std::size_t station : stations.pass(ExplorePhase::Out, at(x))) {
      stations.judge(station, ExplorePhase::Out, 0.9);
    }
  }
  EXPECT_FALSE(stations.means());
}

TEST(UnmodelledShare, CountsSurfacesThatGaussiansDoNotHide) {
  cv::Mat alpha(2, 4, CV_8UC3, cv::Scalar::all(255)), depth(2, 4, CV_32FC1, cv::Scalar(3));
  EXPECT_EQ(unmodelled_share(alpha, depth), 0);
  alpha.at<cv::Vec3b>(0, 1) = {127, 127, 127};
  alpha.at<cv::Vec3b>(1, 3) = {0, 0, 0};
  alpha.at<cv::Vec3b>(1, 0) = {128, 128, 128};
  EXPECT_EQ(unmodelled_share(alpha, depth), 2.0 / 8);
  depth.at<float>(1, 3) = 0;
  EXPECT_EQ(unmodelled_share(alpha, depth), 1.0 / 8) << "sky has nothing to model";
}

TEST(ResidentBytes, GrowsByWhatIsWritten) {
  constexpr std::size_t kBytes = 64 << 20;
  void* const block = ::mmap(nullptr, kBytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  ASSERT_NE(block, MAP_FAILED);
  // Of a process of one thread: whatever else this one does at the time counts as well.
  const pid_t child = ::fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    std::raise(SIGSTOP);
    std::memset(block, 1, kBytes);
    std::raise(SIGSTOP);
    ::_exit(0);
  }
  ::waitpid(child, nullptr, WUNTRACED);
  const auto before = resident_bytes(child);
  ::kill(child, SIGCONT);
  ::waitpid(child, nullptr, WUNTRACED);
  const auto after = resident_bytes(child);
  ::kill(child, SIGKILL);
  ::waitpid(child, nullptr, 0);
  ::munmap(block, kBytes);
  ASSERT_TRUE(before && after);
  EXPECT_NEAR(static_cast<double>(*after - *before), kBytes, 8 << 20);
  EXPECT_FALSE(resident_bytes(0x3fffffff));
}

}  // namespace
}  // namespace splatbus::cli
