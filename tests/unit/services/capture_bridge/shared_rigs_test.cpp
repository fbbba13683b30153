// Several viewers, and whose cameras are whose.
#include <numeric>

#include "rig_fixture.h"

namespace splatbus::capture_bridge::test {
namespace {

TEST(DivideCameras, ByNeedWithALeastForEach) {
  const auto divide = [](int total, std::vector<float> needs, int least) {
    return divide_cameras(total, needs, least);
  };
  EXPECT_EQ(divide(24, {1}, 4), (std::vector{24}));
  EXPECT_EQ(divide(24, {1, 1}, 4), (std::vector{12, 12}));
  EXPECT_EQ(divide(24, {0, 0}, 4), (std::vector{12, 12}));
  EXPECT_EQ(divide(24, {0, 2}, 4), (std::vector{4, 20}));
  EXPECT_EQ(divide(24, {0.5F, 1.5F}, 4), (std::vector{8, 16}));
  EXPECT_EQ(divide(8, {1, 1, 1}, 1), (std::vector{3, 3, 2}));
  EXPECT_EQ(divide(8, {0.1F, 2, 1}, 4), (std::vector{0, 4, 4})) << "enough for two";
  EXPECT_EQ(divide(3, {1, 2}, 4), (std::vector{0, 3}));
  EXPECT_EQ(divide(2, {1, 1, 1}, 1), (std::vector{1, 1, 0})) << "those who came first";
  EXPECT_EQ(divide(0, {1, 1}, 1), (std::vector{0, 0}));
  EXPECT_TRUE(divide(8, {}, 1).empty());
  for (int total = 1; total < 40; ++total) {
    const auto shares = divide(total, {0.3F, 1.7F, 0.01F, 1, 0.6F}, 3);
    EXPECT_EQ(std::accumulate(shares.begin(), shares.end(), 0), total);
    EXPECT_GE(*std::ranges::min_element(shares), 0);
  }
}

TEST(CameraShares, IdsHaveOneOwnerAndStay) {
  CameraShares shares;
  shares.set_total(8);
  shares.take_share("a", {{"a", 8}});
  ASSERT_EQ(shares.of("a").size(), 8U);
  EXPECT_EQ(shares.of("a")[7], 7U);
  shares.take_share("b", {{"a", 5}, {"b", 3}});
  EXPECT_EQ(std::vector(shares.of("a").begin(), shares.of("a").end()), (std::vector<std::uint32_t>{0, 1, 2, 3, 4}));
  EXPECT_EQ(shares.of("b").size(), 3U);
  shares.take_share("c", {{"b", 3}, {"c", 2}});
  EXPECT_EQ(shares.of("a").size(), 3U) << "who has no share any more gives first";
  EXPECT_EQ(shares.of("b").size(), 3U);
  shares.release("b");
  shares.take_share("c", {{"a", 3}, {"c", 5}});
  EXPECT_EQ(shares.of("a").size(), 3U) << "what is free goes first";
  std::set<std::uint32_t> all;
  for (const auto& [owner, ids] : shares.all()) all.insert(ids.begin(), ids.end());
  EXPECT_EQ(all.size(), 8U);
  shares.set_total(2);
  EXPECT_EQ(shares.of("a").size(), 2U);
  EXPECT_TRUE(shares.of("c").empty());
}

TEST(Viewers, KnowVelocitiesJumpsAndOrder) {
  Poses told;
  Viewers viewers;
  const auto tell = [&](const std::string& name, const glm::vec3& eye, std::int64_t now_ns) {
    told.tell(name, standing(eye), now_ns);
    told.poses.expire(now_ns);
    viewers.update(told.poses, 3, now_ns);
  };
  for (int i = 0; i <= 20; ++i) tell("walker", {0.14F * static_cast<float>(i), 1, 0}, i * kSecond / 10);
  EXPECT_NEAR(viewers.all().at("walker").velocity_m_s.x, 1.4F, 0.01F);
  EXPECT_EQ(viewers.all().at("walker").jumps, 0U);
  tell("walker", {50, 1, 0}, 21 * kSecond / 10);
  EXPECT_EQ(viewers.all().at("walker").velocity_m_s, glm::vec3(0));
  EXPECT_EQ(viewers.all().at("walker").jumps, 1U);
  tell("a later one", {70, 1, 0}, 21 * kSecond / 10);
  EXPECT_EQ(viewers.in_order(), (std::vector<std::string>{"walker", "a later one"}));
  EXPECT_EQ(viewers.middle(10), glm::vec3(50, 1, 0));
  EXPECT_EQ(viewers.middle(30), glm::vec3(60, 1, 0));
  tell("walker", {50.1F, 1, 0}, 22 * kSecond / 10);
  EXPECT_GT(viewers.all().at("walker").velocity_m_s.x, 0);
  viewers.update(told.poses, 3, 3 * kSecond);
  EXPECT_EQ(viewers.all().at("walker").velocity_m_s, glm::vec3(0)) << "it tells no more that it walks";
  tell("a later one", {70, 1, 0}, 5 * kSecond);
  EXPECT_EQ(viewers.in_order(), (std::vector<std::string>{"a later one"}));
  told.poses.expire(9 * kSecond);
  viewers.update(told.poses, 3, 9 * kSecond);
  EXPECT_EQ(viewers.all().size(), 1U) << "the last one is where it was";
}

TEST(Viewers, HeadingIsTheAngleAboutY) {
  for (const float angle : {-2.0F, 0.0F, 0.4F, 3.0F}) {
    const glm::vec3 forward = glm::angleAxis(angle, glm::vec3(0, 1, 0)) * glm::vec3(0, 0, -1);
    EXPECT_NEAR((Viewer{.camera = look_at({0, 0, 0}, forward, 8, 8, 1)}.heading()), angle, 1e-5F);
  }
  EXPECT_EQ((Viewer{.camera = look_at({0, 0, 0}, {0, -1, 0}, 8, 8, 1)}.heading(1.25F)), 1.25F);
}

TEST_F(RigControlTest, TwoViewersFarApartAreBothServedAtOnce) {
  update();
  look("a", standing({0, 1.6F, 0}));
  look("b", standing({100, 1.6F, 0}));
  EXPECT_TRUE(update().empty());
  EXPECT_EQ(about(CameraRole::Input, {0, 1.6F, -3.4F}, 3.5F), 6);
  EXPECT_EQ(about(CameraRole::Input, {100, 1.6F, -3.4F}, 3.5F), 6);
  EXPECT_EQ(about(CameraRole::Reference, {0, 1.6F, 0}, 1), 2);
  EXPECT_EQ(about(CameraRole::Reference, {100, 1.6F, 0}, 1), 2);
  EXPECT_EQ(about(CameraRole::Reference, {0, 1.6F, 0}, 1e-4F), 1) << "aligned";
  EXPECT_EQ(about(CameraRole::Reference, {100, 1.6F, 0}, 1e-4F), 1);
  EXPECT_TRUE(rig("a").round.ready(now_ns_, kSecond)) << "each has its own round";
  EXPECT_TRUE(rig("b").round.ready(now_ns_, kSecond));
  EXPECT_NE(rig("a").round.rig_generation(), rig("b").round.rig_generation());

  // One that walks has another round, and the other's stands.
  const auto of_a = rig("a").round.rig_generation();
  pass(kSecond / 10);
  look("b", standing({101, 1.6F, 0}));
  update();
  EXPECT_EQ(rig("a").round.rig_generation(), of_a);

  // Who leaves frees them all.
  pass(3 * kSecond / 2);
  look("b", standing({101, 1.6F, 0}));
  update();
  pass(kSecond);
  const auto left = update();
  EXPECT_EQ(left.size(), 12U - static_cast<std::size_t>(about(CameraRole::Input, {101, 1.6F, -3.4F}, 3.5F)));
  EXPECT_EQ(about(CameraRole::Reference, {101, 1.6F, 0}, 1), 4);
  pass(kSecond / 10);
  look("b", standing({102, 1.6F, 0}));
  EXPECT_TRUE(update().empty());
  EXPECT_EQ(about(CameraRole::Input, {102, 1.6F, -3.4F}, 3.5F), 12);
}

/// Who looks at new ground has more of the input cameras than who stands where all is known; and gives them back.
TEST_F(RigControlTest, InputCamerasGoWhereTheyAreNeeded) {
  look("a", standing({0, 1.6F, 0}));
  look("b", standing({100, 1.6F, 0}));
  update();
  control_.inputs().note_new_share(rig("a").round.rig_generation(), 0);
  control_.inputs().note_new_share(rig("b").round.rig_generation(), 0.8F);
  pass(kSecond / 10);
  look("b", standing({101, 1.6F, 0}));
  const auto before = rig("a").requested;
  EXPECT_TRUE(update().empty());
  EXPECT_EQ(rig("a").cameras.size(), 4U);
  EXPECT_EQ(rig("b").cameras.size(), 8U);
  for (const auto& [id, request_id] : rig("a").requested) {
    EXPECT_EQ(before.at(id), request_id) << "those that stay are not rendered again";
  }
  EXPECT_EQ(rig("a").round.views().size(), 4U);
  float low = 10, high = 0;
  for (const Camera& camera : rig("a").cameras) {
    low = std::min(low, camera.world_from_camera.translation.y - 1.6F);
    high = std::max(high, camera.world_from_camera.translation.y - 1.6F);
  }
  EXPECT_LT(low, 1) << "thinner, and still a dome";
  EXPECT_GT(high, 2);
  control_.inputs().note_new_share(rig("b").round.rig_generation(), 0);
  for (int i = 1; i < 4; ++i) {
    pass(kSecond / 10);
    look("a", standing({static_cast<float>(i), 1.6F, 0}));
    look("b", standing({101, 1.6F, 0}));
    update();
  }
  EXPECT_GT(rig("a").cameras.size(), 6U);
  EXPECT_EQ(rig("a").cameras.size() + rig("b").cameras.size(), 12U);
}

TEST_F(RigControlTest, WhereSamplesAreNewWeighsAsMuchAsMotion) {
  look("a", standing({0, 1.6F, 0}));
  look("b", standing({100, 1.6F, 0}));
  update();
  control_.inputs().note_new_share(rig("a").round.rig_generation(), 0);
  control_.inputs().note_new_share(rig("b").round.rig_generation(), 0.8F);
  for (int i = 1; i < 3; ++i) {
    pass(kSecond / 10);
    look("a", standing({static_cast<float>(i), 1.6F, 0}));
    look("b", standing({100 + static_cast<float>(i), 1.6F, 0}));
    update();
    EXPECT_EQ(rig("a").cameras.size(), 4U);
    EXPECT_EQ(rig("b").cameras.size(), 8U);
  }
}

TEST_F(RigControlTest, MoreViewersThanCamerasTakeTurns) {
  set("input_cameras", "8");
  set("reference_cameras", "2");
  const auto all_look = [&](float x) {
    for (int i = 0; i < 5; ++i)
      look(std::string("v").append(std::to_string(i)), standing({100.0F * static_cast<float>(i) + x, 1.6F, 0}));
    update();
    pass(kSecond / 10);
  };
  std::set<std::string> served;
  for (int step = 0; step < 12; ++step) {
    all_look(0);
    for (auto& [name, rig] : control_.inputs().all()) {
      if (rig.round.rig_generation() == 0) continue;
      served.insert(name);
      control_.inputs().note_new_share(rig.round.rig_generation(), 0);
    }
    EXPECT_LE(of(CameraRole::Input).size(), 8U);
  }
  EXPECT_EQ(served.size(), 5U);
  EXPECT_EQ(of(CameraRole::Reference).size(), 2U);
  EXPECT_EQ(about(CameraRole::Reference, {0, 1.6F, 0}, 1e-4F), 1);
}

TEST_F(RigControlTest, WhoStandsStillGetsCamerasBackThatOthersTook) {
  set("input_cameras", "4");
  look("a", standing({0, 1.6F, 0}));
  update();
  control_.inputs().note_new_share(rig("a").round.rig_generation(), 0.5F);
  pass(kSecond / 10);
  look("b", standing({100, 1.6F, 0}));
  update();
  ASSERT_EQ(rig("b").cameras.size(), 4U);
  ASSERT_TRUE(rig("a").cameras.empty());
  control_.inputs().note_new_share(rig("b").round.rig_generation(), 0);
  pass(kSecond / 10);
  update();
  EXPECT_EQ(rig("a").cameras.size(), 4U) << "though it has not moved";
}

TEST_F(RigControlTest, CascadesLieAboutTheViewersThatAreNearEachOther) {
  Light light;
  look("a", standing({10, 1.6F, 0}));
  look("b", standing({30, 1.6F, 0}));
  look("c", standing({300, 1.6F, 0}));
  update();
  control_.update_lights(light);
  Camera whole{.role = CameraRole::Light, .width = 1024, .height = 1024};
  whole.fx = whole.fy = 1024.0F / 283;
  control_.lights().saw(0, 0, whole);
  control_.update_lights(light);
  const auto maps = control_.cameras().of_role(CameraRole::Light);
  ASSERT_EQ(maps.size(), 3U);
  for (const CameraRequest& map : maps) {
    if (map.extent_m == 0) continue;
    EXPECT_EQ(map.camera.world_from_camera.translation, glm::vec3(20, 1.6F, 0));
  }
}

}  // namespace
}  // namespace splatbus::capture_bridge::test
