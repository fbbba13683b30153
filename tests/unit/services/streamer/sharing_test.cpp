// Replicas of the streamer: each page is encoded by one of them, and shown by the viewers of all.
#include "sharing_fixture.h"

namespace splatbus::stream_test {
namespace {

TEST_F(SharingTest, EachPageIsEncodedByOneAndShownByTheViewersOfBoth) {
  const auto one = streamer(kOne), two = streamer(kTwo);
  trainer_.publish(model_);
  const auto a = viewer_of(*one), b = viewer_of(*two);
  ASSERT_TRUE(until({a.get(), b.get()}, [&] {
    return shows_model(*a) && shows_model(*b) && divided({kOne, kTwo}, *a);
  }));
  train({a.get(), b.get()}, 1500ms);
  ASSERT_TRUE(until({a.get(), b.get()},
                    [&] { return shows_model(*a) && shows_model(*b) && hold_the_same(a->replica(), b->replica()); }));
  EXPECT_EQ(a->replica().epoch(), b->replica().epoch());
  EXPECT_GT(said_[kOne].deltas, 10U);
  EXPECT_GT(said_[kTwo].deltas, 10U);
  EXPECT_GE(said_[kOne].pages.size(), 4U);
  EXPECT_GE(said_[kTwo].pages.size(), 4U);
  EXPECT_EQ(a->refused() + b->refused(), 0U);
}

TEST_F(SharingTest, OneWithoutViewersEncodesForThoseOfTheOther) {
  const auto one = streamer(kOne), two = streamer(kTwo);
  trainer_.publish(model_);
  const auto a = viewer_of(*one);
  ASSERT_TRUE(until({a.get()}, [&] { return shows_model(*a) && divided({kOne, kTwo}, *a); }));
  // Small steps need no whole page, while the machine keeps up. What was given counts as held for a second.
  bool followed = false;
  for (int k = 0; k < 10 && !followed; ++k) {
    const Said before = said_[kTwo];
    train({a.get()}, 1500ms, 0.005F);
    followed = said_[kTwo].answers == before.answers && said_[kTwo].deltas > before.deltas + 5;
  }
  EXPECT_TRUE(followed) << "by deltas of pages that nobody here holds, but somebody there";
  train({a.get()}, 200ms);  // what moves by less than a step is left as it is
  ASSERT_TRUE(until({a.get()}, [&] { return shows_model(*a); }));
  EXPECT_GT(said_[kTwo].answers, 0U) << "pages that its viewer lacked";
  EXPECT_EQ(a->refused(), 0U);
}

TEST_F(SharingTest, OneAloneSaysNothing) {
  const auto one = streamer(kOne);
  trainer_.publish(model_);
  const auto a = viewer_of(*one);
  ASSERT_TRUE(until({a.get()}, [&] { return shows_model(*a); }));
  train({a.get()}, 1500ms);
  EXPECT_TRUE(said_.empty());
}

TEST_F(SharingTest, WhoComesLaterGoesOnWithTheStreamThatThereIs) {
  const auto one = streamer(kOne);
  trainer_.publish(model_);
  const auto a = viewer_of(*one);
  ASSERT_TRUE(until({a.get()}, [&] { return shows_model(*a); }));
  const std::uint64_t epoch = a->replica().epoch();
  const auto two = streamer(kTwo);
  const auto b = viewer_of(*two);
  bool stood = true, own = false;
  ASSERT_TRUE(until({a.get(), b.get()}, [&] {
    stood = stood && a->replica().count() == model_.count() && a->replica().epoch() == epoch;
    own = own || (b->replica().epoch() != 0 && b->replica().epoch() != epoch);
    return divided({kOne, kTwo}, *a) && shows_model(*a) && shows_model(*b);
  }));
  EXPECT_TRUE(stood) << "what is shown stays while pages go over";
  EXPECT_EQ(b->replica().epoch(), epoch);
  EXPECT_FALSE(own) << "it waits to hear in which stream others are";
  train({a.get(), b.get()}, 500ms);
  ASSERT_TRUE(until({a.get(), b.get()},
                    [&] { return shows_model(*a) && shows_model(*b) && hold_the_same(a->replica(), b->replica()); }));
  EXPECT_EQ(a->refused() + b->refused(), 0U);
}

TEST_F(SharingTest, AViewerThatMovesIsNotSentTheModelAnew) {
  const auto one = streamer(kOne), two = streamer(kTwo);
  trainer_.publish(model_);
  const auto b = viewer_of(*two);
  std::string endpoint = one->endpoints().front();
  StreamClient a({.endpoint = endpoint,
                  .find_endpoint = [&] { return endpoint; },
                  .name = "mover",
                  .hello_every_ns = 20'000'000,
                  .silence_ns = 20'000'000'000,
                  .pose_every_ns = 0});
  std::size_t pages = 0, welcomes = 0;
  a.lose_packets([&](const stream::ParsedPacket& packet) {
    pages += packet.body() == wire::Body::Page ? 1 : 0;
    welcomes += packet.body() == wire::Body::Welcome ? 1 : 0;
    return false;
  });
  ASSERT_TRUE(until({&a, b.get()}, [&] {
    return shows_model(a) && divided({kOne, kTwo}, a) && hold_the_same(a.replica(), b->replica());
  }));
  EXPECT_GE(pages, a.replica().pages());
  pages = welcomes = 0;
  endpoint = two->endpoints().front();
  ASSERT_TRUE(until({&a, b.get()}, [&] { return welcomes > 0; }));
  const auto end = std::chrono::steady_clock::now() + 500ms;
  ASSERT_TRUE(until({&a, b.get()}, [&] { return std::chrono::steady_clock::now() > end; }));
  EXPECT_EQ(pages, 0U);
  disturb(model_, random_);
  trainer_.publish(model_);
  ASSERT_TRUE(until({&a, b.get()}, [&] { return shows_model(a); })) << "it is told of what changes";
}

TEST_F(SharingTest, AllViewersSeeTheLightAsRelightSaysOfEitherOnesPages) {
  const auto one = streamer(kOne, {{"visibility_hz", "100"}}), two = streamer(kTwo, {{"visibility_hz", "100"}});
  const std::vector<std::uint32_t> index = trainer_.publish(model_);
  const auto a = viewer_of(*one), b = viewer_of(*two);
  ASSERT_TRUE(until({a.get(), b.get()}, [&] {
    return shows_model(*a) && shows_model(*b) && divided({kOne, kTwo}, *a);
  }));
  trainer_.publish_light({.generation = 1});
  ASSERT_TRUE(until({a.get(), b.get()},
                    [&] { return a->replica().scene_version() != 0 && b->replica().scene_version() != 0; }));
  std::map<std::uint64_t, std::size_t> column;
  for (std::size_t i = 0; i < model_.count(); ++i) column[model_.gaussian_id[i]] = i;
  for (std::uint64_t version = 1; version <= 5; ++version) {
    std::vector<std::uint8_t> of_index(*std::ranges::max_element(index) + 1, 90);
    const auto seen = [&](std::uint64_t id) {
      return static_cast<std::uint8_t>((id * 7 + version) % 3 != 0 ? 0 : 255);
    };
    for (std::size_t i = 0; i < index.size(); ++i) of_index[index[i]] = seen(model_.gaussian_id[i]);
    trainer_.publish_visibility(of_index, trainer_.generation(), version);
    const auto sees = [&](const StreamClient& viewer) {
      const stream::ReplicatedState& held = viewer.replica().held();
      const auto& sun = held.gaussians.channels[held.layout.at(stream::Attribute::Visibility).first];
      const auto ids = ids_by_row(viewer.replica(), model_);
      return ids.size() == model_.count() &&
             std::ranges::all_of(ids, [&](const auto& entry) { return sun[entry.first] == seen(entry.second); });
    };
    ASSERT_TRUE(until({a.get(), b.get()}, [&] { return sees(*a) && sees(*b); })) << "version " << version;
  }
  EXPECT_EQ(a->refused() + b->refused(), 0U);
}

}  // namespace
}  // namespace splatbus::stream_test
