// The bridge's parts that need no bus: the camera set, rounds, probes, the trainer watch.
#include <gtest/gtest.h>

#include <glm/gtc/constants.hpp>

#include "../../nanoseconds.h"
#include "capture-bridge/input_worker.h"
#include "capture-bridge/new_share.h"
#include "capture-bridge/probe_table.h"
#include "capture-bridge/requests.h"
#include "capture-bridge/rig.h"
#include "capture-bridge/sampler.h"
#include "capture-bridge/trainer_watch.h"

namespace splatbus::capture_bridge {
namespace {

std::vector<std::uint64_t> ids_of(const CameraSet& set, CameraRole role) {
  std::vector<std::uint64_t> ids;
  for (const CameraRequest& request : set.of_role(role)) ids.push_back(request.request_id);
  return ids;
}

TEST(CameraSet, KeepsRequestsOfCamerasThatStay) {
  CameraSet set(100);
  const auto ring = ring_cameras({.cameras = 4});
  EXPECT_TRUE(set.replace(CameraRole::Reference, ring, wire::EngineBuffer::Color, 1).empty());
  const auto before = ids_of(set, CameraRole::Reference);
  EXPECT_GT(before.front(), 100U);
  EXPECT_TRUE(set.take_changed());
  EXPECT_FALSE(set.take_changed());

  EXPECT_TRUE(set.replace(CameraRole::Reference, ring, wire::EngineBuffer::Color, 1).empty());
  EXPECT_FALSE(set.take_changed());
  EXPECT_EQ(ids_of(set, CameraRole::Reference), before);

  auto fewer = ring;
  fewer.pop_back();
  fewer[0].world_from_camera.translation.x += 1;
  const auto left = set.replace(CameraRole::Reference, fewer, wire::EngineBuffer::Color, 1);
  ASSERT_EQ(left.size(), 1U);
  EXPECT_EQ(left[0].id, 3U);
  const auto after = ids_of(set, CameraRole::Reference);
  EXPECT_GT(after[0], before.back());
  EXPECT_EQ(after[1], before[1]);
}

TEST(CameraSet, ReissuesUnderNewIdsAndLeavesOtherRolesAlone) {
  CameraSet set(0);
  set.replace(CameraRole::Reference, ring_cameras({.cameras = 3}), wire::EngineBuffer::Color, 0);
  set.replace(CameraRole::Input, dome_cameras({.cameras = 3}, glm::vec3(0), 0), wire::EngineBuffer::Color, 0);
  const auto references = ids_of(set, CameraRole::Reference);
  const auto inputs = ids_of(set, CameraRole::Input);
  const std::vector<std::uint32_t> second{1};
  set.reissue(CameraRole::Input, second);
  EXPECT_EQ(ids_of(set, CameraRole::Reference), references);
  EXPECT_EQ(ids_of(set, CameraRole::Input)[0], inputs[0]);
  EXPECT_GT(ids_of(set, CameraRole::Input)[1], inputs[2]);
  set.remove(CameraRole::Input, 0);
  EXPECT_EQ(set.of_role(CameraRole::Input).size(), 2U);
}

class InputRoundTest : public testing::Test {
 protected:
  InputRoundTest() {
    set_.replace(CameraRole::Input, dome_cameras({.cameras = 3}, glm::vec3(0), 0), wire::EngineBuffer::Color, 0);
    round_.begin(set_.of_role(CameraRole::Input), ++generations_);
  }
  bool add(std::uint32_t camera, std::int64_t now) {
    return round_.add(camera, set_.of_role(CameraRole::Input)[camera].request_id, std::make_shared<InputView>(), now);
  }
  std::uint64_t generations_ = 0;
  CameraSet set_{0};
  InputRound round_;
};

TEST_F(InputRoundTest, IsReadyWhenAllHaveCome) {
  EXPECT_FALSE(round_.ready(100 * kSecond, kSecond)) << "a round without a frame is never due";
  EXPECT_TRUE(add(0, 0));
  EXPECT_TRUE(add(2, 0));
  EXPECT_FALSE(round_.ready(kSecond / 2, kSecond));
  EXPECT_EQ(round_.missing(), std::vector<std::uint32_t>{1});
  EXPECT_TRUE(add(1, kSecond / 2));
  EXPECT_TRUE(round_.ready(kSecond / 2, kSecond));
  EXPECT_EQ(round_.take().size(), 3U);
  EXPECT_FALSE(round_.ready(100 * kSecond, kSecond));
}

TEST_F(InputRoundTest, ALostFrameDelaysItAndComesAfter) {
  add(0, 0);
  add(1, 0);
  EXPECT_TRUE(round_.ready(kSecond, kSecond));
  EXPECT_EQ(round_.take().size(), 2U);
  set_.reissue(CameraRole::Input, round_.missing());
  round_.renew(set_.of_role(CameraRole::Input));
  EXPECT_TRUE(add(2, 2 * kSecond));
  EXPECT_TRUE(round_.ready(2 * kSecond, kSecond)) << "the straggler completes the rig";
  EXPECT_EQ(round_.take().size(), 3U);
}

/// The scene has changed: what has appeared is in the first of them.
TEST_F(InputRoundTest, FramesThatAreRenderedAgainAreARoundOfTheirOwnAndSoon) {
  for (std::uint32_t i = 0; i < 3; ++i) add(i, 0);
  EXPECT_FALSE(round_.refreshes());
  EXPECT_EQ(round_.take().size(), 3U);
  EXPECT_TRUE(round_.refreshes());
  add(1, 10 * kSecond);
  EXPECT_FALSE(round_.ready(10 * kSecond, kSecond));
  EXPECT_TRUE(round_.ready(10 * kSecond + kSecond / 4, kSecond));
  EXPECT_EQ(round_.take_fresh(), std::vector{round_.views()[1]});
  EXPECT_FALSE(round_.ready(100 * kSecond, kSecond));
  EXPECT_EQ(round_.take().size(), 3U) << "for who missed them";
}

TEST_F(InputRoundTest, ARigThatIsNotWholeWaits) {
  add(0, 0);
  add(1, 0);
  EXPECT_EQ(round_.take().size(), 2U);
  EXPECT_FALSE(round_.refreshes());
  add(0, 10 * kSecond);
  EXPECT_FALSE(round_.ready(10 * kSecond + kSecond / 2, kSecond));
}

TEST_F(InputRoundTest, RefusesFramesOfAnotherRig) {
  EXPECT_FALSE(round_.awaits(0, 999));
  EXPECT_TRUE(round_.awaits(0, set_.of_role(CameraRole::Input)[0].request_id));
  EXPECT_FALSE(round_.add(0, 999, std::make_shared<InputView>(), 0));
  EXPECT_FALSE(round_.add(77, set_.of_role(CameraRole::Input)[0].request_id, std::make_shared<InputView>(), 0));
  EXPECT_TRUE(round_.empty());
  add(0, 0);
  const std::uint64_t generation = round_.rig_generation();
  round_.begin(set_.of_role(CameraRole::Input), ++generations_);
  EXPECT_GT(round_.rig_generation(), generation);
  EXPECT_EQ(round_.views().size(), 1U) << "that camera has not been asked for anew";
  set_.reissue_all(CameraRole::Input);
  round_.begin(set_.of_role(CameraRole::Input), ++generations_);
  EXPECT_TRUE(round_.empty());
}

TEST_F(InputRoundTest, WaitsForNoCameraThatIsDropped) {
  add(0, 0);
  add(1, 0);
  EXPECT_FALSE(round_.ready(0, kSecond));
  round_.drop(2);
  EXPECT_TRUE(round_.ready(0, kSecond));
  EXPECT_TRUE(round_.missing().empty());
  round_.drop(0);
  EXPECT_EQ(round_.take().size(), 1U);
}

TEST_F(InputRoundTest, AtARateEveryCameraMustBringANewFrame) {
  for (std::uint32_t i = 0; i < 3; ++i) add(i, 0);
  EXPECT_EQ(round_.take().size(), 3U);
  add(0, kSecond);
  EXPECT_FALSE(round_.ready(kSecond, kSecond));
  add(1, kSecond);
  add(2, kSecond);
  EXPECT_TRUE(round_.ready(kSecond, kSecond));
}

TEST(StalestFirst, IsAskedForAnewWhenTheSceneHasChanged) {
  StalestFirst pictures;
  constexpr std::int64_t kLater = StalestFirst::kPatienceNs;
  EXPECT_FALSE(pictures.take(9, 0)) << "what was never there is missing, not stale";
  pictures.arrived(0, 5);
  pictures.arrived(1, 3);
  pictures.arrived(2, 4);
  EXPECT_FALSE(pictures.take(3, 0));
  EXPECT_EQ(pictures.take(5, 0), 1U);
  EXPECT_EQ(pictures.take(5, 0), 2U) << "camera 1's is on its way";
  EXPECT_FALSE(pictures.take(5, 0));
  EXPECT_EQ(pictures.take(5, kLater), 1U) << "it never came";
  pictures.arrived(1, 5);
  EXPECT_EQ(pictures.take(6, kLater), 2U);
  pictures.forget(0);
  EXPECT_EQ(pictures.take(6, kLater), 1U);
  pictures.clear();
  EXPECT_FALSE(pictures.take(9, 2 * kLater));
}

TEST(ProbeTable, AnswersEachOnce) {
  ProbeTable table(4);
  std::optional<Probe> evicted;
  Probe* probe = table.add(7, "viewer", {}, 0, evicted);
  ASSERT_NE(probe, nullptr);
  ProbeTable::ask(*probe, 70, 0);
  EXPECT_EQ(table.add(7, "viewer", {}, 0, evicted), nullptr) << "the same probe again";
  Probe* other = table.add(7, "another", {}, 0, evicted);
  ASSERT_NE(other, nullptr);
  ProbeTable::ask(*other, 71, 0);
  EXPECT_FALSE(table.answer(other->camera.id, 70));
  const auto answered = table.answer(other->camera.id, 71);
  ASSERT_TRUE(answered);
  EXPECT_EQ(answered->asker, "another");
  EXPECT_FALSE(table.answer(answered->camera.id, 71));
  EXPECT_EQ(table.size(), 1U);
}

TEST(ProbeTable, AnEngineThatTakesLongerThanItIsGivenAnswersAllTheSame) {
  ProbeTable table(4);
  std::optional<Probe> evicted;
  Probe* probe = table.add(7, "viewer", {}, 0, evicted);
  ProbeTable::ask(*probe, 70, 0);
  const std::vector<Probe*> late = table.overdue(3);
  ASSERT_EQ(late.size(), 1U);
  ProbeTable::ask(*late[0], 75, 3);
  EXPECT_TRUE(table.overdue(3).empty()) << "asked a moment ago";
  EXPECT_FALSE(table.answer(probe->camera.id, 69)) << "of somebody's before";
  EXPECT_FALSE(table.answer(probe->camera.id, 76));
  EXPECT_TRUE(table.answer(probe->camera.id, 70)) << "to what it was asked first";
}

TEST(ProbeTable, IsBoundedAndForgetsTheOld) {
  ProbeTable table(2);
  std::optional<Probe> evicted;
  table.add(1, "viewer", {}, 0, evicted);
  table.add(2, "viewer", {}, 5, evicted);
  EXPECT_FALSE(evicted);
  table.add(3, "viewer", {}, 6, evicted);
  ASSERT_TRUE(evicted);
  EXPECT_EQ(evicted->probe_id, 1U);
  EXPECT_EQ(table.overdue(6).size(), 1U);
  const auto expired = table.expire(6);
  ASSERT_EQ(expired.size(), 1U);
  EXPECT_EQ(expired[0].probe_id, 2U);
}

TEST(NewShareWatch, LearnsWhatRoundsCameToInTheirOrder) {
  NewShareWatch watch;
  EXPECT_TRUE(watch.state(1, 4, 500).empty()) << "of rounds before ours";
  watch.published({{.rig_generation = 11, .samples = 100}});
  EXPECT_TRUE(watch.state(1, 4, 500).empty());
  auto shares = watch.state(1, 5, 530);
  ASSERT_EQ(shares.size(), 1U);
  EXPECT_EQ(shares[0].rig_generation, 11U);
  EXPECT_FLOAT_EQ(shares[0].of_samples, 0.3F);
  watch.published({{.rig_generation = 12, .samples = 100}, {.rig_generation = 13, .samples = 300}});
  shares = watch.state(1, 7, 630);
  ASSERT_EQ(shares.size(), 2U);
  EXPECT_EQ(shares[1].rig_generation, 13U);
  EXPECT_FLOAT_EQ(shares[0].of_samples, 0.25F);
  EXPECT_FLOAT_EQ(shares[1].of_samples, 0.25F);
  watch.published({{.rig_generation = 14, .samples = 10}});
  EXPECT_TRUE(watch.state(2, 3, 0).empty()) << "another expander";
  EXPECT_TRUE(watch.state(2, 4, 100).empty()) << "who has not seen it";
}

TEST(TrainerWatch, AsksAgainForANewTrainerButNotForEver) {
  TrainerWatch watch;
  EXPECT_FALSE(watch.lacks_views(1, 8, 8, 0, 10 * kSecond));
  EXPECT_FALSE(watch.lacks_views(1, 7, 8, 9 * kSecond, 10 * kSecond)) << "the last view may be under way";
  int demands = 0;
  for (int i = 0; i < 100; ++i) demands += watch.lacks_views(1, 7, 8, 0, (10 + i) * kSecond) ? 1 : 0;
  EXPECT_GE(demands, 2);
  EXPECT_LE(demands, 5);
  EXPECT_FALSE(watch.lacks_views(1, 0, 8, 0, 200 * kSecond));
  EXPECT_TRUE(watch.lacks_views(2, 0, 8, 0, 200 * kSecond)) << "another trainer";
  EXPECT_TRUE(watch.lacks_views(3, 0, 8, 201 * kSecond, 201 * kSecond))
      << "which has seen nothing that was sent before";
  EXPECT_FALSE(watch.lacks_views(4, 0, 8, 201 * kSecond, 201 * kSecond)) << "the engine has that to render";
}

}  // namespace
}  // namespace splatbus::capture_bridge
