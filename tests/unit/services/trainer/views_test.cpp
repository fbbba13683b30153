#include <gtest/gtest.h>

#include <map>
#include <memory>
#include <set>
#include <string>

#include "trainer/view_sampler.h"
#include "trainer/view_store.h"

namespace splatbus::trainer {
namespace {

TrainingViewPtr make_view(CameraRole role, std::uint32_t id, std::uint64_t frame = 0, std::size_t bytes = 16,
                          std::uint64_t version = 0) {
  TrainingView view;
  view.camera.role = role;
  view.camera.id = id;
  view.frame = frame;
  view.scene.version = version;
  view.color = Pixels<std::uint8_t>(std::vector<std::uint8_t>(bytes));
  return std::make_shared<const TrainingView>(std::move(view));
}

TEST(ViewStore, KeepsTheNewestOfEachCamera) {
  ViewStore store;
  store.put(make_view(CameraRole::Reference, 1, 1));
  store.put(make_view(CameraRole::Input, 1, 2));
  store.put(make_view(CameraRole::Reference, 1, 3));
  EXPECT_EQ(store.count(CameraRole::Reference), 1U);
  EXPECT_EQ(store.find({.role = CameraRole::Reference, .id = 1})->frame, 3U);
  EXPECT_EQ(store.find({.role = CameraRole::Input, .id = 1})->frame, 2U);
  EXPECT_EQ(store.bytes(), 32U);
}

TEST(ViewStore, ForgetsWhatRetiresButNotWhatIsInUse) {
  ViewStore store;
  store.put(make_view(CameraRole::Reference, 1));
  const auto held = store.find({.role = CameraRole::Reference, .id = 1});
  const auto version = store.cameras_version();
  store.retire({.role = CameraRole::Reference, .id = 1});
  store.retire({.role = CameraRole::Reference, .id = 2});
  EXPECT_EQ(store.find({.role = CameraRole::Reference, .id = 1}), nullptr);
  EXPECT_EQ(store.bytes(), 0U);
  EXPECT_EQ(held->color.size(), 16U);
  EXPECT_EQ(store.cameras_version(), version + 1);
}

TEST(ViewStore, MakesRoomByTheViewUpdatedLongestAgo) {
  ViewStore store(3, 1000);
  for (std::uint32_t id = 0; id < 3; ++id) store.put(make_view(CameraRole::Reference, id));
  store.put(make_view(CameraRole::Reference, 0));
  store.put(make_view(CameraRole::Reference, 3));
  EXPECT_EQ(store.find({.role = CameraRole::Reference, .id = 1}), nullptr);
  EXPECT_NE(store.find({.role = CameraRole::Reference, .id = 0}), nullptr);
  store.put(make_view(CameraRole::Reference, 4, 0, 990));
  EXPECT_EQ(store.count(CameraRole::Reference), 1U) << "bounded in bytes too";
}

TEST(ViewSampler, TakesOneInputViewAfterThreeReferences) {
  ViewStore store;
  for (std::uint32_t id = 0; id < 8; ++id) store.put(make_view(CameraRole::Reference, id));
  for (std::uint32_t id = 0; id < 40; ++id) store.put(make_view(CameraRole::Input, id));
  ViewSampler sampler(7);
  std::map<CameraRole, int> drawn;
  for (int i = 0; i < 400; ++i) ++drawn[sampler.next(store, {.input = 3})->camera.role];
  EXPECT_EQ(drawn[CameraRole::Reference], 300);
  EXPECT_EQ(drawn[CameraRole::Input], 100);
}

TEST(ViewSampler, BatchesAreOfOneKind) {
  ViewStore store;
  for (std::uint32_t id = 0; id < 8; ++id) store.put(make_view(CameraRole::Reference, id));
  for (std::uint32_t id = 0; id < 3; ++id) store.put(make_view(CameraRole::Input, id));
  ViewSampler sampler(7);
  std::string kinds;
  for (int i = 0; i < 8; ++i) {
    const auto batch = sampler.next_batch(store, 4, {.input = 3});
    ASSERT_EQ(batch.size(), 4U);
    for (const auto& view : batch) EXPECT_EQ(view->camera.role, batch.front()->camera.role);
    kinds += batch.front()->camera.role == CameraRole::Input ? 'i' : 'r';
  }
  EXPECT_EQ(kinds, "rrrirrri");
  EXPECT_TRUE(sampler.next_batch(ViewStore(), 4, {.input = 3}).empty());
}

TEST(ViewSampler, VisitsEveryReferenceOnceAnEpochInChangingOrder) {
  ViewStore store;
  for (std::uint32_t id = 0; id < 10; ++id) store.put(make_view(CameraRole::Reference, id));
  ViewSampler sampler(7);
  std::set<std::vector<std::uint32_t>> orders;
  for (int epoch = 0; epoch < 5; ++epoch) {
    std::vector<std::uint32_t> order;
    for (int i = 0; i < 10; ++i) order.push_back(sampler.next(store, {.input = 0})->camera.id);
    orders.insert(order);
    EXPECT_EQ(std::set<std::uint32_t>(order.begin(), order.end()).size(), 10U);
  }
  EXPECT_GT(orders.size(), 1U);
}

TEST(ViewSampler, IsTheSameForTheSameSeed) {
  ViewStore store;
  for (std::uint32_t id = 0; id < 10; ++id) store.put(make_view(CameraRole::Reference, id));
  ViewSampler a(3);
  ViewSampler b(3);
  ViewSampler c(4);
  int differing = 0;
  for (int i = 0; i < 50; ++i) {
    const auto id = a.next(store, {.input = 0})->camera.id;
    EXPECT_EQ(id, b.next(store, {.input = 0})->camera.id);
    differing += id == c.next(store, {.input = 0})->camera.id ? 0 : 1;
  }
  EXPECT_GT(differing, 10);
}

TEST(ViewSampler, MakesDoWithWhatIsThere) {
  ViewStore store;
  ViewSampler sampler(1);
  EXPECT_EQ(sampler.next(store, {.input = 3}), nullptr);
  store.put(make_view(CameraRole::Input, 5));
  EXPECT_EQ(sampler.next(store, {.input = 0}), nullptr);
  EXPECT_EQ(sampler.next(store, {.input = 3})->camera.id, 5U);
  store.put(make_view(CameraRole::Reference, 6));
  store.retire({.role = CameraRole::Input, .id = 5});
  for (int i = 0; i < 8; ++i) EXPECT_EQ(sampler.next(store, {.input = 3})->camera.id, 6U);
}

TEST(ViewSampler, AViewWithLessToTeachHasFewerTurnsAndAtLeastAFourth) {
  ViewStore store;
  for (std::uint32_t id = 0; id < 6; ++id) store.put(make_view(CameraRole::Reference, id));
  ViewSampler sampler(7);
  // Their mean is 0.1. One has never been looked at; of another nothing shows that trains.
  const float losses[5] = {0.19F, 0.14F, 0.1F, 0.06F, 0.01F};
  for (std::uint32_t id = 0; id < 5; ++id) sampler.learn({.role = CameraRole::Reference, .id = id}, losses[id], 1);
  std::map<std::uint32_t, int> drawn;
  std::map<std::uint32_t, int> last;
  for (int i = 0; i < 485; ++i) {
    const std::uint32_t id = sampler.next(store, {.input = 0})->camera.id;
    ++drawn[id];
    EXPECT_LE(i - std::exchange(last[id], i), 4 * 6) << id;
  }
  for (const std::uint32_t id : {0, 1, 2, 5}) EXPECT_NEAR(drawn[id], 100, 1) << id;
  EXPECT_NEAR(drawn[3], 60, 1);
  EXPECT_NEAR(drawn[4], 25, 1);

  sampler.learn({.role = CameraRole::Reference, .id = 2}, 0.1F, 0);
  drawn.clear();
  for (int i = 0; i < 485; ++i) ++drawn[sampler.next(store, {.input = 0})->camera.id];
  EXPECT_LT(drawn[2], 40);
  EXPECT_GT(drawn[2], 20);

  sampler.forget();
  std::set<std::uint32_t> all;
  for (int i = 0; i < 18; ++i) all.insert(sampler.next(store, {.input = 0})->camera.id);
  EXPECT_EQ(all.size(), 6U);
}

TEST(ViewSampler, WhereThoseWhoseTurnItIsHaveNoPictureOthersHaveIt) {
  ViewStore store;
  store.set_paired(std::vector<PairedVersion>{{.version = 1}});
  store.put(make_view(CameraRole::Reference, 1, 0, 16, 9));  // waits
  store.put(make_view(CameraRole::Reference, 2, 0, 16, 1));
  ViewSampler sampler(7);
  sampler.learn({.role = CameraRole::Reference, .id = 1}, 1, 1);
  sampler.learn({.role = CameraRole::Reference, .id = 2}, 0.01F, 1);
  for (int i = 0; i < 9; ++i) {
    const auto view = sampler.next(store, {.input = 0});
    ASSERT_NE(view, nullptr);
    EXPECT_EQ(view->camera.id, 2U);
  }
}

/// Of the sun alone.
std::vector<PairedVersion> paired(std::initializer_list<std::uint64_t> versions) {
  std::vector<PairedVersion> all;
  for (const std::uint64_t version : versions) all.push_back({.version = version});
  return all;
}

TEST(ViewStore, AViewTrainsOnceItsOwnVersionIsThere) {
  const ViewKey key{.role = CameraRole::Reference, .id = 1};
  const auto picture = [](std::uint64_t frame, std::uint64_t version) {
    return make_view(CameraRole::Reference, 1, frame, 16, version);
  };
  ViewStore store;
  store.set_paired(paired({}));
  store.put(picture(1, 10));
  EXPECT_EQ(store.find(key), nullptr);
  EXPECT_FALSE(store.any_to_train(CameraRole::Reference));
  store.set_paired(paired({10}));
  EXPECT_EQ(store.find(key)->frame, 1U);
  store.put(picture(2, 11));
  EXPECT_EQ(store.find(key)->frame, 1U) << "the older picture trains with its own until the newer one's is there";
  EXPECT_EQ(store.versions(), (std::vector<std::uint64_t>{10, 11}));
  EXPECT_EQ(store.bytes(), 32U);
  store.put(picture(3, 12));
  EXPECT_EQ(store.unpaired(), 1U) << "frame 2 went without its version";
  store.set_paired(paired({10, 11, 12}));
  EXPECT_EQ(store.find(key)->frame, 3U);
  EXPECT_EQ(store.bytes(), 16U);
  store.set_paired(paired({13}));
  EXPECT_EQ(store.find(key), nullptr) << "its version has gone";
  store.put(picture(4, 13));
  EXPECT_EQ(store.find(key)->frame, 4U);
  EXPECT_EQ(store.unpaired(), 1U);
}

/// As those that a successor has gathered, before the visibilities that came meanwhile are taken in.
TEST(ViewStore, AViewWhoseVisibilityIsNotThereAnyMoreWaitsForIt) {
  const ViewKey key{.role = CameraRole::Input, .id = 1};
  const auto picture = [](std::uint64_t frame, std::uint64_t version) {
    return make_view(CameraRole::Input, 1, frame, 16, version);
  };
  ViewStore store;
  store.put(picture(1, 10));
  ASSERT_NE(store.find(key), nullptr) << "none needs any so far";
  store.set_paired(paired({}));
  EXPECT_EQ(store.find(key), nullptr);
  EXPECT_EQ(store.versions(), (std::vector<std::uint64_t>{10})) << "what is asked for";
  EXPECT_EQ(store.bytes(), 16U);
  store.set_paired(paired({10}));
  ASSERT_NE(store.find(key), nullptr) << "lost for good: nobody sends it again";
  EXPECT_EQ(store.find(key)->frame, 1U);

  store.put(picture(2, 11));
  store.set_paired(paired({}));
  EXPECT_EQ(store.versions(), (std::vector<std::uint64_t>{11})) << "the newer one waits";
  EXPECT_EQ(store.bytes(), 16U);
  store.set_paired(paired({10, 11}));
  EXPECT_EQ(store.find(key)->frame, 2U);
  EXPECT_EQ(store.unpaired(), 0U);
}

TEST(ViewStore, AViewWaitsForTheVisibilityOfAllItsLights) {
  const ViewKey key{.role = CameraRole::Reference, .id = 1};
  TrainingView view = *make_view(CameraRole::Reference, 1, 1, 16, 10);
  view.scene.light.sources = {{.id = 4}, {.id = 9}};
  ViewStore store;
  store.set_paired(std::vector<PairedVersion>{{10, {0, 4}}, {11, {0, 4, 9}}});
  store.put(std::make_shared<const TrainingView>(view));
  EXPECT_EQ(store.find(key), nullptr);
  store.set_paired(std::vector<PairedVersion>{{10, {0, 4, 7}}, {11, {0, 4, 9}}});
  EXPECT_EQ(store.find(key), nullptr);
  store.set_paired(std::vector<PairedVersion>{{10, {0, 4, 9}}});
  EXPECT_NE(store.find(key), nullptr);
  store.set_paired(std::vector<PairedVersion>{{10, {0, 4}}});
  view.frame = 2;
  store.put(std::make_shared<const TrainingView>(view));
  store.put(std::make_shared<const TrainingView>(view));
  EXPECT_EQ(store.unpaired(), 1U) << "it was replaced before it had its lights";
  store.retire(key);
  EXPECT_EQ(store.unpaired(), 2U) << "and the next one's camera has left";
}

TEST(ViewSampler, SkipsCamerasThatRetiredWithinAnEpoch) {
  ViewStore store;
  for (std::uint32_t id = 0; id < 4; ++id) store.put(make_view(CameraRole::Reference, id));
  ViewSampler sampler(1);
  const auto first = sampler.next(store, {.input = 0})->camera.id;
  for (std::uint32_t id = 0; id < 4; ++id) {
    if (id != first) store.retire({.role = CameraRole::Reference, .id = id});
  }
  EXPECT_EQ(sampler.next(store, {.input = 0})->camera.id, first);
}

}  // namespace
}  // namespace splatbus::trainer
