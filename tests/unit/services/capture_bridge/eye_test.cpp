// The input camera that stands where its viewer will be, between two places of its dome.
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <string>

#include "capture-bridge/dome.h"
#include "rig_fixture.h"

namespace splatbus::capture_bridge::test {
namespace {

/// A viewer whose eye goes ahead of its dome.
class GoingEyeTest : public RigControlTest {
 protected:
  GoingEyeTest() {
    look("v", standing({0, 1.6F, 0}));
    update();
    EXPECT_TRUE(rig("v").eye);
    eye_ = *rig("v").eye;
    place_ = rig("v").round.rig_generation();
    (void)rig("v").round.take();
    rig("v").glance.reset();
  }
  [[nodiscard]] Camera eye() {
    for (const Camera& camera : of(CameraRole::Input)) {
      if (camera.id == eye_) return camera;
    }
    return {};
  }
  float see(const Camera& from, std::int64_t after_ns = kSecond / 4) {
    pass(after_ns);
    look("v", from);
    update(false);
    return eye().world_from_camera.translation.x;
  }
  float step(float x, std::int64_t after_ns = kSecond / 4) { return see(standing({x, 1.6F, 0}), after_ns); }

  std::uint32_t eye_ = 0;
  std::uint64_t place_ = 0;
};

TEST_F(GoingEyeTest, OnePictureAtATime) {
  EXPECT_EQ(step(0.2F), 0) << "none for a hand's breadth";
  EXPECT_NEAR(step(0.3F), 0.3F, 1e-5F);
  EXPECT_NEAR(step(0.05F), 0.3F, 1e-5F) << "until it has shown that";
  EXPECT_EQ(rig("v").glance, nullptr);
  answer_input(eye_);
  EXPECT_NE(rig("v").glance, nullptr) << "it is worth a look";
  EXPECT_FALSE(rig("v").round.ready(now_ns_ + 60 * kSecond, kSecond)) << "and no reason for another round";
  EXPECT_NEAR(step(0.02F, kSecond / 50), 0.05F, 0.031F) << "on its way again";
  EXPECT_EQ(rig("v").round.rig_generation(), place_) << "the dome stays";
  EXPECT_EQ(rig("v").round.take().size(), 12U);
}

TEST_F(GoingEyeTest, NotMoreOftenThanItsPictureIsOfUse) {
  EXPECT_NEAR(step(0.3F), 0.3F, 1e-5F);
  answer_input(eye_);
  EXPECT_NEAR(step(0, kSecond / 10), 0.3F, 1e-5F);
  EXPECT_NEAR(step(0, kSecond / 10), 0, 1e-5F);
}

TEST_F(GoingEyeTest, APictureThatIsLostIsAskedForAgain) {
  EXPECT_NEAR(step(0.3F), 0.3F, 1e-5F);
  const auto request = [&] { return rig("v").requested.at(eye_); };
  const std::uint64_t lost = request();
  step(0.3F, kSecond);
  EXPECT_EQ(request(), lost);
  step(0.3F, kSecond);
  EXPECT_NE(request(), lost);
}

/// It has been drawn back from there, and looks elsewhere than its viewer.
TEST_F(GoingEyeTest, WhereItIsBlindItIsNotAskedAgainAndAgain) {
  step(2);
  answer_input(eye_);
  const Camera aside = look_at({2, 1.6F, 0}, {2.4F, 1.6F, -1}, 64, 64, 1);
  see(aside);
  control_.inputs().blind(rig("v"), eye_, now_ns_, control_.cameras());
  EXPECT_LT((eye().world_from_camera.rotation * glm::vec3(0, 0, 1)).x, 0.05F);
  answer_input(eye_);
  const std::uint64_t asked = rig("v").requested.at(eye_);
  for (int k = 0; k < 5; ++k) see(aside);
  EXPECT_EQ(rig("v").requested.at(eye_), asked) << "of who stands still";
}

TEST_F(GoingEyeTest, ItLooksAboutWhileItsDomeIsRenderedAndDelaysNothing) {
  step(2);
  EXPECT_GT(rig("v").round.rig_generation(), place_);
  answer_input(eye_);
  EXPECT_NE(rig("v").glance, nullptr) << "at once";
  const std::uint64_t missing = rig("v").round.missing().size();
  see(look_at({2, 1.6F, 0}, {2.4F, 1.6F, -1}, 64, 64, 1));
  EXPECT_GT((eye().world_from_camera.rotation * glm::vec3(0, 0, 1)).x, 0.3F);
  const std::int64_t asked_ns = rig("v").asked_ns;
  answer_input(eye_);
  EXPECT_EQ(rig("v").asked_ns, asked_ns) << "what is missing is asked for again as if it had not come";
  EXPECT_EQ(rig("v").round.missing().size(), missing);
}

TEST_F(GoingEyeTest, UnlessItIsNotWanted) {
  set("glance_share", "0");
  step(2);
  answer_all();
  EXPECT_EQ(step(2.3F), 2);
}

/// Of who turns by a quarter in a second the eye looks half of that ahead.
TEST(Eye, LooksWhereTheViewerWillHaveTurned) {
  Poses told;
  Viewers viewers;
  for (int k = 0; k <= 20; ++k) {
    const float angle = 0.5F * glm::pi<float>() * static_cast<float>(k) / 20;
    const glm::vec3 ahead(std::sin(angle), 0, -std::cos(angle));
    told.tell("v", look_at({0, 1.6F, 0}, glm::vec3(0, 1.6F, 0) + ahead, 64, 64, 1), kSecond + k * kSecond / 20);
    viewers.update(told.poses, 3, kSecond + k * kSecond / 20);
  }
  const Viewer& viewer = viewers.all().begin()->second;
  const auto gaze = [&](float lead_s) {
    const Camera eye = eye_camera({.size = 64}, {.lead_s = lead_s}, viewer, nullptr, 0);
    return eye.world_from_camera.rotation * glm::vec3(0, 0, 1);
  };
  EXPECT_LT(glm::distance(gaze(0), glm::vec3(1, 0, 0)), 1e-4F);
  EXPECT_LT(glm::distance(gaze(0.5F), glm::normalize(glm::vec3(1, 0, 1))), 0.02F);
  EXPECT_LT(glm::distance(gaze(10), glm::vec3(0, 0, 1)), 0.02F) << "no farther than a quarter of a turn";
}

/// Viewers of whose cameras some look about.
class LookingAboutTest : public RigControlTest {
 protected:
  void have(int about, int cameras) {
    set("input_about", std::to_string(about).c_str());
    set("input_cameras", std::to_string(cameras).c_str());
  }
  void stand(float x_m, bool answer = true) {
    look("v", standing({x_m, 1.6F, 0}));
    update(answer);
  }
};

/// They are few, and the dome would take an engine as long as he takes to pass.
TEST_F(LookingAboutTest, ThoseThatLookAboutComeBeforeTheDome) {
  have(3, 16);
  const glm::vec3 eye(0, 1.6F, 0);
  stand(eye.x, false);
  EXPECT_EQ(rig("v").cameras.size(), 4U);
  EXPECT_EQ(about(CameraRole::Input, eye, 1e-4F), 4) << "and no other is asked for yet";
  EXPECT_NEAR(rig("v").share_asked(), 4.0 / 16, 1e-6) << "they are a part of it";
  update(false);
  EXPECT_EQ(rig("v").cameras.size(), 4U) << "until they are there";
  answer_all();
  update(false);
  EXPECT_EQ(rig("v").cameras.size(), 16U);
  EXPECT_EQ(about(CameraRole::Input, eye, 1e-4F), 4);
  EXPECT_EQ(rig("v").round.missing().size(), 12U);
}

/// A place of which a part is there is not one that others have robbed.
TEST_F(LookingAboutTest, WhoHardlyMovesGetsTheDomeAfterThoseThatLookAbout) {
  have(2, 9);
  stand(0);
  EXPECT_EQ(rig("v").cameras.size(), 3U);
  pass(kSecond / 10);
  stand(0.01F, false);
  EXPECT_EQ(rig("v").cameras.size(), 9U);
  EXPECT_EQ(rig("v").round.missing().size(), 6U);
}

/// Or he would never get one.
TEST_F(LookingAboutTest, WhoPassesAPlaceBeforeItsDomeGetsTheNextOnesAtOnce) {
  have(3, 16);
  stand(0);
  pass(kSecond);
  stand(1.5F);
  EXPECT_EQ(rig("v").cameras.size(), 16U);
  pass(kSecond);
  stand(3);
  EXPECT_EQ(rig("v").cameras.size(), 4U) << "of the one after it those that look about come first";
}

TEST_F(LookingAboutTest, OthersTakeThoseThatLookAboutFirst) {
  have(5, 24);
  for (int k = 0; k < 3; ++k) {
    look("a", standing({0, 1.6F, 0}));
    update();
  }
  EXPECT_EQ(rig("a").about.size(), 5U);
  for (int k = 0; k < 3; ++k) {
    look("a", standing({0, 1.6F, 0}));
    look("b", standing({100, 1.6F, 0}));
    update();
  }
  ASSERT_LT(rig("a").cameras.size(), 20U);
  EXPECT_EQ(rig("a").cameras.front().id, *rig("a").eye);
  for (const Camera& camera : rig("a").cameras) EXPECT_FALSE(rig("a").about.contains(camera.id)) << camera.id;
}

TEST_F(LookingAboutTest, ABlindOneThatLooksAboutIsGivenUp) {
  have(3, 16);
  stand(0, false);
  const std::uint32_t blind = *rig("v").about.begin();
  control_.inputs().blind(rig("v"), blind, now_ns_, control_.cameras());
  EXPECT_EQ(rig("v").round.missing().size(), 3U);
  answer_all();
  update(false);
  EXPECT_EQ(rig("v").round.missing().size(), 12U);
}

TEST_F(LookingAboutTest, FewCamerasLookAboutAmongFew) {
  have(5, 9);
  stand(0, false);
  EXPECT_EQ(about(CameraRole::Input, {0, 1.6F, 0}, 1e-4F), 3);
}

/// Who came later has the others' last cameras, and keeps his eye when they want some back.
TEST_F(RigControlTest, TheEyeIsRenderedFirstAndKeptLongest) {
  look("a", standing({0, 1.6F, 0}));
  update();
  for (int k = 0; k < 3; ++k) {
    pass(kSecond / 4);
    look("a", standing({static_cast<float>(k), 1.6F, 0}));
    look("b", standing({100, 1.6F, 0}));
    update();
  }
  ASSERT_TRUE(rig("b").eye);
  for (const Camera& camera : rig("b").cameras) EXPECT_GE(camera.id, *rig("b").eye);
}

}  // namespace
}  // namespace splatbus::capture_bridge::test
