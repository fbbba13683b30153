// Where both rigs stand for one viewer.
#include "rig_fixture.h"

namespace splatbus::capture_bridge::test {
namespace {

TEST_F(RigControlTest, StandsAboutThePlaceOfInterestUntilAViewerComes) {
  update();
  EXPECT_EQ(about(CameraRole::Input, {0, 0.25F, 0}, 3.5F), 12);
  EXPECT_EQ(about(CameraRole::Reference, {0, 1.6F, 0}, 3.5F), 4);
  for (const Camera& camera : of(CameraRole::Reference)) {
    EXPECT_GT(camera.world_from_camera.translation.length(), 2) << "on the ring";
  }
  control_.cameras().take_changed();
  update();
  EXPECT_FALSE(control_.cameras().take_changed()) << "nothing moved, nothing is asked for again";
  look("v", standing({8, 1.6F, 0}));
  EXPECT_TRUE(update().empty()) << "the same cameras, elsewhere";
  EXPECT_EQ(about(CameraRole::Input, {8, 1.6F, -3.4F}, 3.5F), 12);
  const auto references = of(CameraRole::Reference);
  ASSERT_EQ(references.size(), 4U);
  EXPECT_LT(glm::distance(references[0].world_from_camera.translation, glm::vec3(8, 1.6F, 0)), 1e-5F);
  EXPECT_LT(glm::distance(references[1].world_from_camera.translation, glm::vec3(7.4F, 1.6F, 0)), 1e-4F);
  EXPECT_LT(glm::distance(references[3].world_from_camera.translation, glm::vec3(8, 2.2F, 0)), 1e-4F);
  pass(10 * kSecond);
  control_.cameras().take_changed();
  EXPECT_TRUE(update().empty());
  EXPECT_FALSE(control_.cameras().take_changed()) << "it has left, and finds all as it was";
}

TEST_F(RigControlTest, OnTheRingWhoeverLooks) {
  set("reference_rig", "ring");
  look("v", standing({8, 1.6F, 0}));
  update();
  EXPECT_EQ(about(CameraRole::Reference, {0, 1.6F, 0}, 3.5F), 4);
  set("reference_rig", "follow");
  update();
  EXPECT_EQ(about(CameraRole::Reference, {8, 1.6F, 0}, 1), 4);
  set("reference_cameras", "2");
  const auto left = update();
  ASSERT_EQ(left.size(), 2U);
  EXPECT_EQ(left[0].id, 2U);
  set("input_cameras", "0");
  EXPECT_EQ(update().size(), 12U);
  EXPECT_TRUE(of(CameraRole::Input).empty());
  set("input_cameras", "3");
  update();
  EXPECT_EQ(of(CameraRole::Input).size(), 3U);
}

TEST_F(RigControlTest, TakesOverTheViewersPicture) {
  look("v", look_at({8, 1.6F, 0}, {5, 0.25F, 0}, 320, 160, 1));
  update();
  for (const Camera& camera : of(CameraRole::Reference)) EXPECT_NEAR(camera.width, 2 * camera.height, 2);
  pass(kSecond / 10);
  look("v", look_at({8, 1.6F, 0}, {5, 0.25F, 0}, 160, 160, 1));
  update();
  for (const Camera& camera : of(CameraRole::Reference)) EXPECT_EQ(camera.width, camera.height);
  set("follow_picture", "own");
  set("reference_size", "96x48");
  set("input_size", "80x32");
  set("fov_deg", "50");
  set("input_fov_deg", "90");
  update();
  for (const Camera& camera : of(CameraRole::Reference)) {
    EXPECT_EQ(camera.width, 96U);
    EXPECT_EQ(camera.height, 48U);
    EXPECT_NEAR(2 * std::atan(24 / camera.fy), glm::radians(50.0F), 1e-4F);
  }
  for (const Camera& camera : of(CameraRole::Input)) {
    EXPECT_EQ(camera.width, 80U);
    EXPECT_NEAR(camera.fy, 16, 1e-3F);
  }
  EXPECT_EQ(parameters_.read<Options>().round_sizes().pixels, 80U * 32U);
}

TEST_F(RigControlTest, MovesBeyondItsThresholdsAndWithTheHeight) {
  look("v", standing({0, 1.6F, 0}));
  update();
  const auto generation = [&] { return rig("v").round.rig_generation(); };
  const auto first = generation();
  pass(kSecond / 10);
  look("v", standing({0.4F, 1.6F, 0}));
  update();
  EXPECT_EQ(generation(), first);
  EXPECT_LT(glm::distance(of(CameraRole::Reference)[0].world_from_camera.translation, glm::vec3(0.4F, 1.6F, 0)), 1e-5F);
  pass(kSecond / 10);
  look("v", standing({0.4F, 2.0F, 0}));  // up the stairs
  update();
  EXPECT_GT(generation(), first);
  EXPECT_NEAR(rig("v").place.centre.y, 2.0F, 1e-5F);
  EXPECT_EQ(about(CameraRole::Input, {0.4F, 2, -3.4F}, 3.41F), 12);
  // Turning on the spot moves the centre too; turning about the centre turns the dome.
  const glm::vec3 centre = rig("v").place.centre;
  const glm::vec3 ahead = glm::angleAxis(1.2F, glm::vec3(0, 1, 0)) * glm::vec3(0, 0, -1);
  const auto before = generation();
  pass(kSecond / 10);
  look("v", look_at(centre - 3.4F * ahead, centre, 64, 64, 1));
  update();
  EXPECT_GT(generation(), before);
  EXPECT_NEAR(rig("v").place.heading_radians, 1.2F, 1e-4F);
}

TEST_F(RigControlTest, OneInputCameraIsTheViewersEye) {
  look("v", standing({0, 1.6F, 0}));
  update();
  EXPECT_EQ(about(CameraRole::Input, {0, 1.6F, 0}, 0.01F), 1);
  const Camera eye = of(CameraRole::Input)[0];
  EXPECT_LT(glm::distance(eye.world_from_camera.rotation * glm::vec3(0, 0, 1), glm::vec3(0, 0, -1)), 1e-4F);
}

TEST_F(RigControlTest, AHeadingThatWrapsIsNotATurn) {
  set("input_center", "0,0.25,0");
  const auto look_along = [&](float angle) {
    look("v", look_at({0, 1, 0}, glm::vec3(0, 1, 0) + glm::angleAxis(angle, glm::vec3(0, 1, 0)) * glm::vec3(0, 0, -1),
                      64, 64, 1));
    update();
    pass(kSecond / 10);
    return rig("").round.rig_generation();
  };
  const auto generation = look_along(3.1F);
  EXPECT_EQ(look_along(-3.1F), generation);
  EXPECT_GT(look_along(-1.5F), generation);
}

TEST_F(RigControlTest, ARigThatIsRenderedStaysButForWhoJumps) {
  look("v", standing({0, 1.6F, 0}));
  update();
  const auto generation = [&] { return rig("v").round.rig_generation(); };
  const auto step = [&](float x, bool answer) {
    pass(kSecond / 10);
    look("v", standing({x, 1.6F, 0}));
    update(answer);
    return generation();
  };
  const auto walked = step(1, false);
  EXPECT_EQ(step(2, false), walked) << "pictures are on their way";
  const auto jumped = step(40, false);
  EXPECT_GT(jumped, walked) << "elsewhere at once, and whole";
  EXPECT_EQ(about(CameraRole::Input, {40, 1.6F, -3.4F}, 3.5F), 12);
  EXPECT_EQ(about(CameraRole::Reference, {40, 1.6F, 0}, 1), 4);
  EXPECT_EQ(step(80, false), jumped) << "who does nothing but jump would see no round";
  EXPECT_EQ(about(CameraRole::Reference, {80, 1.6F, 0}, 1), 0) << "nor a picture";
  pass(kSecond / 2);
  step(80, false);
  EXPECT_EQ(about(CameraRole::Reference, {80, 1.6F, 0}, 1), 4) << "but not for ever";
  pass(3 * kSecond / 2);
  EXPECT_GT(step(80, true), jumped);
  EXPECT_GT(step(120, false), jumped + 1);
}

TEST_F(RigControlTest, ABlindCameraIsTriedElsewhereAndThenGivenUp) {
  look("v", standing({0, 1.6F, 0}));
  update(false);
  const auto request_of = [&](std::uint32_t id) {
    for (const CameraRequest& request : control_.cameras().of_role(CameraRole::Input)) {
      if (request.camera.id == id) return request;
    }
    return CameraRequest{};
  };
  glm::vec3 eye = request_of(5).camera.world_from_camera.translation;
  for (int tries = 0; tries < 2; ++tries) {
    const CameraRequest request = request_of(5);
    InputRig* const waiting = control_.inputs().awaiting(5, request.request_id);
    ASSERT_NE(waiting, nullptr);
    control_.inputs().blind(*waiting, 5, now_ns_, control_.cameras());
    const CameraRequest next = request_of(5);
    EXPECT_GT(next.request_id, request.request_id);
    EXPECT_LT(glm::distance(next.camera.world_from_camera.translation, glm::mix(eye, glm::vec3(0, 1.6F, 0), 0.5F)),
              1e-4F);
    eye = next.camera.world_from_camera.translation;
  }
  control_.inputs().blind(rig("v"), 5, now_ns_, control_.cameras());
  EXPECT_EQ(control_.inputs().awaiting(5, request_of(5).request_id), nullptr);
  answer_all();
  EXPECT_TRUE(rig("v").round.ready(now_ns_, kSecond)) << "without it";
  EXPECT_EQ(rig("v").round.views().size(), 11U);
}

TEST_F(RigControlTest, ABlindCameraIsNotAskedForAgainAsItsDomeGrows) {
  set("input_cameras", "24");
  const auto turn = [&](float metres) {
    walked_m_ += metres;
    pass(kSecond / 4);
    look("v", standing({walked_m_, 1.6F, 0}));
    update(false);
  };
  for (int i = 0; i < 48; ++i) {  // until it is known how slow the engine is
    turn(i == 24 ? 2.0F : 0);
    answer_oldest_input();
  }
  turn(2);
  ASSERT_LT(rig("v").cameras.size(), 12U) << "a part of the dome";
  const std::uint32_t id = rig("v").cameras.back().id;
  for (int tries = 0; tries < 3; ++tries) control_.inputs().blind(rig("v"), id, now_ns_, control_.cameras());
  for (int i = 0; i < 60; ++i) {
    const auto missing = rig("v").round.missing();
    ASSERT_EQ(std::ranges::count(missing, id), 0) << i;
    answer_oldest_input();
    turn(0);
  }
  EXPECT_EQ(rig("v").round.views().size(), 23U);
  EXPECT_EQ(rig("v").share_asked(), 1);
}

TEST_F(RigControlTest, ADomeThatWasNotTestedIsTestedOnceFreeSpaceIsKnown) {
  set("input_range_hz", "2");
  update();
  look("v", standing({0, 1.6F, 0}));
  update();
  EXPECT_EQ(about(CameraRole::Input, {0, 0.25F, 0}, 3.5F), 12) << "it waits for its cube";
  pass(kSecond * 4 / 10);
  update();
  EXPECT_EQ(about(CameraRole::Input, {0, 1.6F, -3.4F}, 3.5F), 12) << "but not for long";
  const auto beyond = [&] {
    return std::ranges::count_if(of(CameraRole::Input),
                                 [](const Camera& camera) { return camera.world_from_camera.translation.z < -4.5F; });
  };
  EXPECT_GT(beyond(), 2);
  EXPECT_EQ(answer_cubes(4.5F), 6);
  update();
  EXPECT_FLOAT_EQ(rig("v").place.centre.z, -3.4F) << "it has not moved";
  EXPECT_EQ(beyond(), 0);
  EXPECT_TRUE(control_.cameras().of_role(CameraRole::Probe).empty());
  const auto generation = rig("v").round.rig_generation();
  update();
  EXPECT_EQ(rig("v").round.rig_generation(), generation);
}

TEST_F(RigControlTest, OfEqualNeedWhoeverHasWaitedLongestGetsTheCube) {
  set("input_range_hz", "2");
  // Both outrun every cube, so that neither ever has one of use: their need is the same.
  std::map<std::string, int> asked;
  float x = 0;
  for (; now_ns_ < 10 * kSecond; pass(kSecond / 100)) {
    x += 2;
    look("a", standing({x, 1.6F, 0}));
    look("b", standing({x, 1.6F, 500}));
    update();
    for (const Camera& camera : of(CameraRole::Probe)) {
      ++asked[camera.world_from_camera.translation.z < 250 ? "a" : "b"];
    }
    answer_cubes(10);
  }
  EXPECT_GE(asked["a"], 6 * 8);
  EXPECT_NEAR(asked["a"], asked["b"], 6 * 2);
}

/// Who walks has a cube of use all the while, and is in less need than one who outruns each of his: he has new ones
/// all the same.
TEST_F(RigControlTest, WhoOutrunsHisCubesStarvesNobody) {
  set("input_range_hz", "2");
  int walkers = 0;
  float ran = 0, walked = 0;
  for (; now_ns_ < 10 * kSecond; pass(kSecond / 100)) {
    look("runs", standing({ran += 2, 1.6F, 0}));
    look("walks", standing({walked += 0.014F, 1.6F, 500}));
    update();
    for (const Camera& camera : of(CameraRole::Probe)) walkers += camera.world_from_camera.translation.z > 250 ? 1 : 0;
    answer_cubes(10);
  }
  EXPECT_GE(walkers, 6 * 8);
}

TEST_F(RigControlTest, CubesAreBoundedAndAskedForWhereTheyAreOfUse) {
  set("input_range_hz", "2");
  int faces = 0;
  float x = 0;
  for (; now_ns_ < 11 * kSecond; pass(kSecond / 100)) {
    look("v", standing({x += 2, 1.6F, 0}));
    update();
    faces += answer_cubes(10);
  }
  EXPECT_GE(faces, 6 * 20);
  EXPECT_LE(faces, 6 * 23);
  // At rest there is one, and no more until it is of no use: it is far off, or a wall is between.
  const auto asked = [&] {
    pass(2 * kSecond);
    look("v", standing({x, 1.6F, 0}));
    update();
    return answer_cubes(2);
  };
  asked();
  EXPECT_EQ(asked(), 0);
  x += 0.6F;
  EXPECT_EQ(asked(), 0);
  x += 0.6F;
  EXPECT_EQ(asked(), 6);
  set("input_move_m", "2");
  x += 2.5F;  // where the cube has shown a wall
  EXPECT_EQ(asked(), 6);
  // A cube that never comes is given up.
  x += 9;
  pass(2 * kSecond);
  look("v", standing({x, 1.6F, 0}));
  update();
  EXPECT_EQ(control_.cameras().of_role(CameraRole::Probe).size(), 6U);
  const auto before = control_.cameras().of_role(CameraRole::Probe).front().request_id;
  pass(kSecond * 7 / 2);
  update();
  EXPECT_GT(control_.cameras().of_role(CameraRole::Probe).front().request_id, before);
}

TEST_F(RigControlTest, CubesTakeASixthOfTheTime) {
  set("input_range_hz", "20");
  const auto cubes_in = [&](std::int64_t span_ns, std::int64_t cube_ns) {
    int faces = 0;
    std::int64_t asked_ns = now_ns_;
    for (const std::int64_t end_ns = now_ns_ + span_ns; now_ns_ < end_ns; pass(kSecond / 100)) {
      walked_m_ += 0.007F;
      look("v", standing({walked_m_, 1.6F, 0}));
      if (of(CameraRole::Probe).empty()) asked_ns = now_ns_;
      update();
      if (now_ns_ - asked_ns >= cube_ns) faces += answer_cubes(10);
    }
    return faces / 6;
  };
  set("input_move_m", "0.01");
  cubes_in(5 * kSecond, kSecond / 2);
  EXPECT_NEAR(cubes_in(30 * kSecond, kSecond / 2), 10, 2) << "half a second, and then two and a half of rest";
  cubes_in(5 * kSecond, kSecond / 50);
  EXPECT_GE(cubes_in(10 * kSecond, kSecond / 50), 60);
}

/// Of an engine that renders four pictures a second, six seconds' worth of which were asked for at once.
TEST_F(RigControlTest, ASlowEngineIsAskedForAsManyPicturesAsComeInTime) {
  set("input_cameras", "24");
  const auto generation = [&] { return rig("v").round.rig_generation(); };
  const auto walk = [&](float metres) {
    walked_m_ += metres;
    pass(kSecond / 4);
    look("v", standing({walked_m_, 1.6F, 0}));
    update(false);
    return answer_oldest_input();
  };
  look("v", standing({0, 1.6F, 0}));
  update(false);
  EXPECT_EQ(of(CameraRole::Input).size(), 24U) << "nobody knows yet how long they take";
  for (int i = 0; i < 24; ++i) walk(0);
  for (int i = 0; i < 24; ++i) walk(i == 0 ? 2.0F : 0);  // now it is known to answer
  std::int64_t placed_ns = now_ns_, longest_ns = 0;
  std::uint64_t before = generation();
  for (int i = 0; i < 80; ++i) {
    walk(0.35F);
    if (generation() == before) continue;
    longest_ns = std::max(longest_ns, now_ns_ - placed_ns);
    placed_ns = now_ns_;
    before = generation();
  }
  EXPECT_LE(longest_ns, 2 * kSecond) << "a round is of where the viewer is";
  EXPECT_GE(longest_ns, kSecond) << "and no smaller than what comes in time";
  EXPECT_NEAR(rig("v").share_asked(), 6 / 24.0, 2 / 24.0);
  EXPECT_EQ(of(CameraRole::Input).size(), 24U) << "cameras that wait for their turn keep their pictures";

  // Who stops gets the rest of the dome, each picture once, and each part is handed on as it is there.
  std::set<std::uint64_t> answers;
  int asked = 0, parts = 0;
  for (int i = 0; i < 60; ++i) {
    const std::uint64_t answer = walk(0);
    asked += answer != 0 ? 1 : 0;
    answers.insert(answer);
    if (!rig("v").round.ready(now_ns_, 60 * kSecond)) continue;
    EXPECT_TRUE(rig("v").round.missing().empty());
    EXPECT_EQ(rig("v").round.take().size(), rig("v").cameras.size()) << "with those that were there";
    ++parts;
  }
  EXPECT_GE(parts, 3);
  EXPECT_EQ(about(CameraRole::Input, {walked_m_, 1.6F, -3.4F}, 3.5F), 24);
  EXPECT_LE(asked, 24 + 8) << "the round under way and one dome";
  EXPECT_EQ(static_cast<int>(answers.size()), asked + 1) << "and 0";
  EXPECT_TRUE(rig("v").round.missing().empty());
  EXPECT_EQ(rig("v").share_asked(), 1);
  EXPECT_EQ(rig("v").round.views().size(), 24U) << "all of it is sampled together";

  // A changed parameter that moves nothing has nothing rendered again, and loses no picture.
  set("input_clearance_m", "0.31");
  for (int i = 0; i < 8; ++i) EXPECT_EQ(walk(0), 0U);
  EXPECT_EQ(rig("v").round.views().size(), 24U);
}

}  // namespace
}  // namespace splatbus::capture_bridge::test
