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

std::set<float> places(const KeptViews& kept, const std::vector<ViewKey>& keys) {
  std::set<float> at;
  for (const ViewKey& key : keys) at.insert(kept.find(key)->camera.world_from_camera.translation.x);
  return at;
}

TEST(KeptViews, AreOneForAPlaceAndDirection) {
  KeptViews kept;
  for (int k = 0; k <= 25; ++k) kept.keep(view_at(0.1F * static_cast<float>(k)));
  EXPECT_EQ(kept.count(), 3U) << "at 0, 1 and 2 m";
  TrainingView turned = view_at(1);
  turned.camera = look_at({1, 1, 0}, {6, 1, 0}, 4, 4, 1);
  kept.keep(turned);
  EXPECT_EQ(kept.count(), 4U);
  kept.keep(turned);
  EXPECT_EQ(kept.count(), 4U);
}

TEST(KeptViews, OfAnotherSceneOrSizeOrWithoutDepthThereAreNone) {
  KeptViews kept;
  TrainingView flat = view_at(0);
  flat.depth = {};
  kept.keep(flat);
  EXPECT_EQ(kept.count(), 0U);
  kept.keep(view_at(0));
  kept.see(view_at(5));
  EXPECT_EQ(kept.count(), 1U);
  kept.see(view_at(5, 2));
  EXPECT_EQ(kept.count(), 0U);
  EXPECT_EQ(kept.bytes(), 0U);
  kept.keep(view_at(0, 2));
  TrainingView large = view_at(5, 2);
  large.camera.width = 8;
  kept.see(large);
  EXPECT_EQ(kept.count(), 0U);
}

TEST(KeptViews, TheFarthestMakesRoom) {
  const std::size_t bytes = view_at(0).bytes();
  for (const KeptViews::Limits limits : {KeptViews::Limits{.views = 3}, KeptViews::Limits{.bytes = 3 * bytes}}) {
    KeptViews kept(limits);
    for (const float x_m : {0.0F, 4.0F, 10.0F, 6.0F}) kept.keep(view_at(x_m));
    EXPECT_EQ(kept.bytes(), 3 * bytes);
    EXPECT_EQ(places(kept, kept.keys(std::vector{view_at(7).camera}, 100)), (std::set<float>{4, 6, 10}));
  }
}

TEST(KeptViews, ThoseNearbyTrainUnlessACameraShowsTheSame) {
  KeptViews kept;
  for (const float x_m : {0.0F, 4.0F, 10.0F, 30.0F}) kept.keep(view_at(x_m));
  EXPECT_EQ(places(kept, kept.keys(std::vector{view_at(0.5F).camera}, 12)), (std::set<float>{4, 10}));
  EXPECT_EQ(places(kept, kept.keys(std::vector{view_at(0.5F).camera, view_at(29).camera}, 5)),
            (std::set<float>{4, 30}));
}

TEST(KeptViews, AreHeldAgainstNewOnesInTurn) {
  KeptViews kept;
  for (int k = 0; k < 10; ++k) kept.keep(view_at(2 * static_cast<float>(k)));
  std::map<std::uint32_t, int> times;
  for (int turn = 0; turn < 4; ++turn) {
    const auto some = kept.some_about(view_at(9).camera, 5.5F, 3);
    EXPECT_EQ(some.size(), 3U);
    for (const auto& view : some) ++times[view->kept_number];
  }
  EXPECT_EQ(times.size(), 6U) << "those at 4 to 14 m";
  for (const auto& [number, count] : times) EXPECT_EQ(count, 2) << number;
  EXPECT_EQ(kept.some_about(view_at(9).camera, 5.5F, 100).size(), 6U) << "each once";
  kept.drop(std::vector{times.begin()->first});
  EXPECT_EQ(kept.some_about(view_at(9).camera, 5.5F, 100).size(), 5U);
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
  store.put(shared(view_at(9, 7)));
  EXPECT_EQ(store.kept(), 0U) << "the scene is another";
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
