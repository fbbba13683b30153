// What is kept of where reference cameras stood, and when it is trained.
#include "trainer/kept_views.h"

#include <gtest/gtest.h>

#include <map>
#include <memory>
#include <set>

#include "trainer/view_sampler.h"
#include "trainer/view_store.h"

namespace splatbus::trainer {
namespace {

/// Of a camera that looks along z from `x_m`.
TrainingView view_at(float x_m, std::uint64_t version = 1, std::uint32_t camera_id = 0) {
  TrainingView view;
  view.camera = look_at({x_m, 1, 0}, {x_m, 1, 5}, 4, 4, 1);
  view.camera.id = camera_id;
  view.scene.version = version;
  view.color = Pixels<std::uint8_t>(std::vector<std::uint8_t>(64));
  view.depth = Pixels<float>(std::vector<float>(16, 5.0F));
  return view;
}

TrainingViewPtr shared(TrainingView view) {
  return std::make_shared<const TrainingView>(std::move(view));
}

/// Of version 1.
class KeptViewsTest : public testing::Test {
 protected:
  KeptViewsTest() { make({}); }
  void make(const KeptViews::Limits& limits) {
    kept_ = KeptViews(limits);
    EXPECT_TRUE(kept_.see(1).empty());
  }
  /// How many have gone for it.
  std::size_t keep(const TrainingView& view, const std::vector<float>& cameras_m = {0}) {
    std::vector<Camera> cameras;
    for (const float x_m : cameras_m) cameras.push_back(view_at(x_m).camera);
    return kept_.keep(view, cameras).size();
  }
  [[nodiscard]] std::set<float> places(const std::vector<float>& cameras_m, float reach_m) const {
    std::vector<Camera> cameras;
    for (const float x_m : cameras_m) cameras.push_back(view_at(x_m).camera);
    std::set<float> at;
    for (const ViewKey& key : kept_.keys(cameras, reach_m)) {
      at.insert(kept_.find(key)->camera.world_from_camera.translation.x);
    }
    return at;
  }

  KeptViews kept_;
};

TEST_F(KeptViewsTest, AreOneForAPlaceADirectionAndAZoom) {
  for (int k = 0; k <= 25; ++k) keep(view_at(0.1F * static_cast<float>(k)));
  EXPECT_EQ(kept_.count(), 3U) << "at 0, 1 and 2 m";
  TrainingView turned = view_at(1), near = view_at(1);
  turned.camera = look_at({1, 1, 0}, {6, 1, 0}, 4, 4, 1);
  near.camera.fx *= 2;
  near.camera.fy *= 2;
  for (int times = 0; times < 2; ++times) {
    keep(turned);
    keep(near);
    EXPECT_EQ(kept_.count(), 5U);
  }
  // The same with more pixels.
  TrainingView large = near;
  large.camera = look_at({1, 1, 0}, {1, 1, 5}, 8, 8, 1);
  keep(large);
  EXPECT_EQ(kept_.count(), 5U);
}

TEST_F(KeptViewsTest, OneOfLongAgoMakesPlace) {
  make({.lasts = std::chrono::seconds(0)});
  keep(view_at(0));
  TrainingView newer = view_at(0.2F);
  newer.frame = 9;
  EXPECT_EQ(keep(newer), 1U);
  const auto keys = kept_.keys(std::vector{view_at(5).camera}, 100);
  ASSERT_EQ(keys.size(), 1U);
  EXPECT_EQ(kept_.find(keys.front())->frame, 9U);
}

TEST_F(KeptViewsTest, OfAnotherSceneOrWithoutDepthThereAreNone) {
  TrainingView flat = view_at(0);
  flat.depth = {};
  keep(flat);
  keep(view_at(0, 2));
  EXPECT_EQ(kept_.count(), 0U);
  keep(view_at(0));
  EXPECT_TRUE(kept_.see(1).empty());
  EXPECT_EQ(kept_.see(2).size(), 1U);
  EXPECT_EQ(kept_.count(), 0U);
  EXPECT_EQ(kept_.bytes(), 0U);
  keep(view_at(0, 2));
  EXPECT_TRUE(kept_.see(1).empty()) << "an older one";
  EXPECT_EQ(kept_.count(), 1U);
  EXPECT_TRUE(kept_.some_about(view_at(0, 1), 100, 9).empty());
  EXPECT_EQ(kept_.some_about(view_at(0, 2), 100, 9).size(), 1U);
}

TEST_F(KeptViewsTest, TheFarthestFromAllCamerasMakesRoom) {
  const std::size_t bytes = view_at(0).bytes();
  for (const KeptViews::Limits limits : {KeptViews::Limits{.views = 4}, KeptViews::Limits{.bytes = 4 * bytes}}) {
    make(limits);
    for (const float x_m : {0.0F, 4.0F, 10.0F, 90.0F}) EXPECT_EQ(keep(view_at(x_m), {7, 88}), 0U);
    EXPECT_EQ(keep(view_at(6), {7, 88}), 1U);
    EXPECT_EQ(kept_.bytes(), 4 * bytes);
    EXPECT_EQ(places({50}, 100), (std::set<float>{4, 6, 10, 90}));
  }
}

TEST_F(KeptViewsTest, ThoseNearbyTrainUnlessACameraShowsTheSame) {
  for (const float x_m : {0.0F, 4.0F, 10.0F, 30.0F}) keep(view_at(x_m));
  EXPECT_EQ(places({0.5F}, 12), (std::set<float>{4, 10}));
  EXPECT_EQ(places({0.5F, 29}, 5), (std::set<float>{4, 30}));
}

TEST_F(KeptViewsTest, AreHeldAgainstNewOnesInTurn) {
  // Of two viewers, whose pictures come by turns.
  for (int k = 0; k < 6; ++k) {
    keep(view_at(2 * static_cast<float>(k)));
    keep(view_at(100 + 2 * static_cast<float>(k)));
  }
  std::map<std::uint32_t, int> times;
  for (int turn = 0; turn < 4; ++turn) {
    for (const float x_m : {5.0F, 105.0F}) {
      const auto some = kept_.some_about(view_at(x_m), 5.5F, 3);
      EXPECT_EQ(some.size(), 3U);
      for (const auto& view : some) ++times[view->kept_number];
    }
  }
  EXPECT_EQ(times.size(), 12U);
  for (const auto& [number, count] : times) EXPECT_EQ(count, 2) << number;
  EXPECT_EQ(kept_.some_about(view_at(5), 5.5F, 100).size(), 6U) << "each once";
  EXPECT_EQ(kept_.drop(std::vector{times.begin()->first}).size(), 1U);
  EXPECT_EQ(kept_.some_about(view_at(5), 5.5F, 100).size(), 5U);
}

TEST_F(KeptViewsTest, NoneIsTakenForWhatItsCameraSeesNow) {
  keep(view_at(0));
  keep(view_at(3));
  std::set<std::uint32_t> ids{view_at(0).camera.id};
  for (const auto& view : kept_.some_about(view_at(0), 100, 9)) EXPECT_TRUE(ids.insert(view->camera.id).second);
}

TEST(ViewStore, KeepsWhereAReferenceCameraStood) {
  ViewStore store;
  const auto walk = [&](CameraRole role) {
    for (const float x_m : {0.0F, 3.0F, 6.0F}) {
      TrainingView view = view_at(x_m);
      view.camera.role = role;
      store.put(shared(view));
    }
  };
  walk(CameraRole::Reference);
  EXPECT_EQ(store.kept(), 0U) << "nobody has asked for it";
  store.set_keeps(true);
  walk(CameraRole::Input);
  EXPECT_EQ(store.kept(), 0U);
  walk(CameraRole::Reference);
  EXPECT_EQ(store.kept(), 3U) << "where it was before it began, too";
  EXPECT_EQ(store.kept_keys().size(), 2U) << "it stands at 6 m";
  for (const ViewKey& key : store.kept_keys()) EXPECT_NE(store.find(key), nullptr);
  EXPECT_EQ(store.count(CameraRole::Reference), 1U);

  const std::vector<ViewKey> before = store.kept_keys();
  store.set_paired(std::vector<PairedVersion>{{.version = 7}});
  for (const ViewKey& key : before) EXPECT_EQ(store.find(key), nullptr) << "without its visibility";
  store.put(shared(view_at(9, 8)));
  EXPECT_EQ(store.kept(), 0U) << "the scene is another, if its visibility is not there yet";
  store.put(shared(view_at(12, 8)));
  store.set_paired(std::vector<PairedVersion>{{.version = 8}});
  EXPECT_EQ(store.kept(), 0U);
  store.put(shared(view_at(15, 8)));
  EXPECT_EQ(store.kept(), 1U);
}

TEST(ViewSampler, AKeptViewHasItsTurnAfterSoManyReferences) {
  ViewStore store;
  store.set_keeps(true);
  for (const float x_m : {0.0F, 3.0F, 6.0F}) store.put(shared(view_at(x_m)));
  ViewSampler sampler(7);
  int kept = 0;
  for (int i = 0; i < 300; ++i) kept += sampler.next(store, {.kept = 2})->kept_number > 0 ? 1 : 0;
  EXPECT_NEAR(kept, 100, 1);
  for (int i = 0; i < 50; ++i) EXPECT_EQ(sampler.next(store, {})->kept_number, 0U);
}

TEST(ViewSampler, KeptViewsThatHaveLessToTeachHaveFewerTurns) {
  ViewStore store;
  store.set_keeps(true);
  for (const float x_m : {0.0F, 3.0F, 6.0F}) store.put(shared(view_at(x_m)));
  ViewSampler sampler(7);
  const auto share = [&](float of_reference, float of_kept) {
    sampler.learn({.id = 0}, of_reference, 1);
    for (const ViewKey& key : store.kept_keys()) sampler.learn(key, of_kept, 1);
    int kept = 0;
    for (int i = 0; i < 1000; ++i) kept += sampler.next(store, {.kept = 1})->kept_number > 0 ? 1 : 0;
    return kept / 1000.0;
  };
  EXPECT_NEAR(share(0.1F, 0.1F), 0.5, 0.02);
  EXPECT_NEAR(share(0.1F, 0.05F), 1 / 3.0, 0.02) << "half a turn each";
  EXPECT_NEAR(share(0.1F, 0.001F), 0.2, 0.02) << "a fourth at least";
  EXPECT_NEAR(share(0.05F, 0.2F), 0.5, 0.02) << "one at most";
}

}  // namespace
}  // namespace splatbus::trainer
