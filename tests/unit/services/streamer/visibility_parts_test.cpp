// Replicas of relight share the pages of the model: what each says of its own is put together for viewers.
#include <map>

#include "streamer_fixture.h"

namespace splatbus::stream_test {
namespace {

/// A model of four pages, three of the world and one of an object, and a viewer that has all of it.
class VisibilityParts : public StreamerTest {
 protected:
  static constexpr std::uint32_t kPages = 4;

  void SetUp() override {
    start_streamer({{"visibility_hz", "100"}});
    index_ = trainer_.publish(model_);
    indices_ = *std::ranges::max_element(index_) + 1;
    ASSERT_EQ((indices_ + kPageLanes - 1) / kPageLanes, kPages);
    client_ = std::make_unique<StreamClient>(client_options("one"));
    ASSERT_TRUE(poll_until([&] { return client_->replica().count() == model_.count(); }, *client_));
    trainer_.publish_light({.generation = 1});
    ASSERT_TRUE(poll_until([&] { return client_->replica().scene_version() != 0; }, *client_));
  }

  /// Another for each version and Gaussian.
  static std::uint8_t seen(std::uint64_t version, std::uint64_t id) { return (id * 7 + version) % 3 != 0 ? 0 : 255; }

  /// One replica's word on its pages; of all others it has nonsense.
  void publish_part(const std::vector<std::uint32_t>& pages, std::uint64_t version,
                    std::uint32_t page_indices = kPageLanes) {
    std::vector<std::uint8_t> of_index(indices_, 90);
    for (std::size_t i = 0; i < index_.size(); ++i) {
      const std::uint32_t page = index_[i] / kPageLanes;
      if (std::ranges::count(pages, page) > 0) of_index[index_[i]] = seen(version, model_.gaussian_id[i]);
    }
    trainer_.publish_visibility(of_index, trainer_.generation(), version, {0},
                                FakeTrainer::Part{.pages = pages, .page_indices = page_indices});
  }

  /// Until the viewer sees, of each page, what was said of it in that version; 0: what the model says itself.
  bool shows(const std::vector<std::uint64_t>& version_of_page) {
    std::map<std::uint64_t, std::size_t> column;
    for (std::size_t i = 0; i < model_.count(); ++i) column[model_.gaussian_id[i]] = i;
    return poll_until(
        [&] {
          const stream::ReplicatedState& held = client_->replica().held();
          const auto& sun = held.gaussians.channels[held.layout.at(stream::Attribute::Visibility).first];
          return std::ranges::all_of(ids_by_row(client_->replica(), model_), [&](const auto& entry) {
            const auto [row, id] = entry;
            const std::size_t i = column.at(id);
            const std::uint64_t version = version_of_page[index_[i] / kPageLanes];
            const int want = version == 0 ? static_cast<int>(255 * model_.visibility[i]) : seen(version, id);
            return sun[row] == want;
          });
        },
        *client_);
  }

  const GaussiansBuffer model_ = stream::test::toy_model(3000, 1);
  std::vector<std::uint32_t> index_;  ///< of each Gaussian
  std::size_t indices_ = 0;
  std::unique_ptr<StreamClient> client_;
};

TEST_F(VisibilityParts, EachPageHasTheNewestThatWasSaidOfIt) {
  publish_part({0, 2}, 5);
  EXPECT_TRUE(shows({5, 0, 5, 0})) << "of a page that nobody has spoken of the model's own stays";
  publish_part({1, 3}, 5);
  EXPECT_TRUE(shows({5, 5, 5, 5}));
  // One replica is ahead of the other.
  publish_part({0, 2}, 6);
  publish_part({0, 2}, 7);
  publish_part({1, 3}, 6);
  EXPECT_TRUE(shows({7, 6, 7, 6}));
  publish_part({0, 2}, 4);  // late on its way
  publish_part({1, 3}, 8);
  EXPECT_TRUE(shows({7, 8, 7, 8}));
  EXPECT_EQ(client_->replica().visibility_version(), 8U);
}

TEST_F(VisibilityParts, FollowWhatOneReplicaSaidOfAllPagesAndTheOtherWayRound) {
  std::vector<std::uint8_t> whole(indices_, 0);
  const auto fill = [&](std::uint64_t version) {
    for (std::size_t i = 0; i < index_.size(); ++i) whole[index_[i]] = seen(version, model_.gaussian_id[i]);
    trainer_.publish_visibility(whole, trainer_.generation(), version);
  };
  fill(5);
  ASSERT_TRUE(shows({5, 5, 5, 5}));
  publish_part({1}, 6);
  EXPECT_TRUE(shows({5, 6, 5, 5}));
  publish_part({0}, 4);  // older than what is there of its page
  publish_part({3}, 7);
  EXPECT_TRUE(shows({5, 6, 5, 7}));
  fill(8);
  EXPECT_TRUE(shows({8, 8, 8, 8}));
}

TEST_F(VisibilityParts, WhatMakesNoSenseIsLeftOutAndTheRestGoesOn) {
  publish_part({0, 1, 2, 3}, 5, 0);
  publish_part({0, kPages, 0xFFFFFFFF}, 6);
  EXPECT_TRUE(shows({6, 0, 0, 0}));
  publish_part({1, 2, 3}, 6);
  EXPECT_TRUE(shows({6, 6, 6, 6}));
}

}  // namespace
}  // namespace splatbus::stream_test
