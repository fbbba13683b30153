// Replicas that are started again, released, or cut off: no version of a page is two contents, and no stream ends.
#include "sharing_fixture.h"

namespace splatbus::stream_test {
namespace {

/// One that has begun a stream and runs, and one under the test's clock that has joined it though it is older.
class SharingVersions : public SharingTest {
 protected:
  void SetUp() override {
    one_ = streamer(kOne);
    trainer_.publish(model_);
    viewer_ = viewer_of(*one_);
    ASSERT_TRUE(until({viewer_.get()}, [&] { return shows_model(*viewer_); }));
    epoch_ = viewer_->replica().epoch();
    stepped_ = std::make_unique<SteppedStreamer>(process_, changes_of({}));
    ASSERT_TRUE(until({viewer_.get()}, [&] { return shows_model(*viewer_) && divided({kOne, kTwo}, *viewer_); }));
    ASSERT_EQ(viewer_->replica().epoch(), epoch_);
  }
  void move_model() {
    disturb(model_, random_);
    trainer_.publish(model_);
  }
  void claim(const bus::Publisher& liar, std::uint64_t epoch, std::uint32_t version, bool encodes, bool pages) {
    liar.publish(topics::kStreamShare, [&](auto& builder, auto header) {
      std::vector<wire::SharePage> all;
      for (std::uint32_t page = 0; pages && page < 20; ++page) {
        all.emplace_back(page, version, 1, 1, 0, wire::PageBox(), 0, false);
      }
      const auto pages_at = builder.CreateVectorOfStructs(all);
      const float mean_step = viewer_->replica().held().layout.at(stream::Attribute::Mean).quantizer.step;
      return wire::CreateStreamShare(builder, header, epoch, wire::Appearance::Transfer, 0, mean_step, encodes, false,
                                     version, false, 0, 0, 0, pages, pages_at, 0, 0);
    });
  }

  std::shared_ptr<bus::Context> process_ = connect(kTwo);
  std::unique_ptr<RunningStreamer> one_;
  std::unique_ptr<StreamClient> viewer_;
  std::uint64_t epoch_ = 0;
};

TEST_F(SharingVersions, OneThatIsStartedAgainAtOnceUsesNoVersionAgain) {
  for (int k = 0; k < 10; ++k) {
    move_model();
    ASSERT_TRUE(until({viewer_.get()}, [&] { return shows_model(*viewer_); }));
  }
  stepped_.reset();
  process_.reset();
  process_ = connect(kTwo);
  stepped_ = std::make_unique<SteppedStreamer>(process_, changes_of({}));
  said_[kTwo] = {};
  ASSERT_TRUE(until({viewer_.get()}, [&] { return said_[kTwo].messages > 3; }));
  move_model();
  EXPECT_TRUE(until({viewer_.get()}, [&] { return shows_model(*viewer_) && divided({kOne, kTwo}, *viewer_); }));
  EXPECT_EQ(viewer_->replica().epoch(), epoch_);
  EXPECT_EQ(viewer_->refused(), 0U);
}

TEST_F(SharingVersions, OneThatWasReleasedJoinsTheStreamThatItLeft) {
  viewer_.reset();
  ASSERT_TRUE(until({}, [&] { return said_[kTwo].epoch == 0; })) << "it keeps nothing for nobody";
  viewer_ = viewer_of(*one_);
  bool same = true;
  const auto stays = [&] {
    same = same && (said_[kTwo].epoch == 0 || said_[kTwo].epoch == epoch_);
    same = same && (viewer_->replica().epoch() == 0 || viewer_->replica().epoch() == epoch_);
    return same;
  };
  move_model();
  EXPECT_TRUE(until({viewer_.get()}, [&] {
    return stays() && shows_model(*viewer_) && divided({kOne, kTwo}, *viewer_);
  }));
  EXPECT_TRUE(same);
}

TEST_F(SharingVersions, OnesPagesAreNotThoseOfTheOneBeforeUnderItsName) {
  constexpr std::uint32_t kVersion = 150U << 18U;
  auto liar = std::make_unique<bus::Publisher>(connect("streamer-9"));
  claim(*liar, epoch_, kVersion, false, false);
  ASSERT_TRUE(until({viewer_.get()}, [&] { return said_["streamer-9"].messages > 0; }));
  const std::size_t heard = said_["streamer-9"].messages;
  liar.reset();
  bus::Publisher second(connect("streamer-9"));
  bool stood = true;
  const auto end = std::chrono::steady_clock::now() + 1s;
  ASSERT_TRUE(until({viewer_.get()}, [&] {
    claim(second, epoch_, kVersion, true, true);
    stood = stood && divided({kOne, kTwo}, *viewer_);
    return std::chrono::steady_clock::now() > end;
  }));
  EXPECT_TRUE(stood);
  EXPECT_GT(said_["streamer-9"].messages, heard + 10);
}

TEST_F(SharingVersions, WhoEncodesNothingOrTellsNoPagesIsNotJoined) {
  for (const bool encodes : {false, true}) {
    bus::Publisher liar(connect(encodes ? "streamer-8" : "streamer-9"));
    bool stood = true;
    const auto end = std::chrono::steady_clock::now() + 1s;
    ASSERT_TRUE(until({viewer_.get()}, [&] {
      claim(liar, 1, 10, encodes, !encodes);
      stood = stood && viewer_->replica().epoch() == epoch_ && said_[kTwo].epoch == epoch_;
      return std::chrono::steady_clock::now() > end;
    }));
    EXPECT_TRUE(stood) << encodes;
  }
}

TEST_F(SharingVersions, WhereVersionsRunOutAnotherStreamBegins) {
  bus::Publisher liar(connect("streamer-9"));
  constexpr std::uint32_t kBlock = 1U << 18U;
  claim(liar, epoch_, 0xFFFFFFFFU / kBlock * kBlock - 1, false, false);
  EXPECT_TRUE(until({viewer_.get()}, [&] {
    return viewer_->replica().epoch() != epoch_ && said_[kOne].epoch == said_[kTwo].epoch && shows_model(*viewer_) &&
           divided({kOne, kTwo}, *viewer_);
  }));
  move_model();
  EXPECT_TRUE(until({viewer_.get()}, [&] { return shows_model(*viewer_); }));
}

TEST_F(SharingTest, ThoseThatAreCutOffUseVersionsOfTheirOwn) {
  SteppedStreamer one(connect(kOne), changes_of({})), two(connect(kTwo), changes_of({}));
  trainer_.publish(model_);
  const auto a = viewer_at(one.endpoint()), b = viewer_at(two.endpoint());
  const auto turn = [&](double passed_s) {
    one.turn(passed_s);
    two.turn(passed_s);
  };
  ASSERT_TRUE(until({a.get(), b.get()}, [&] {
    turn(0.02);
    return shows_model(*a) && shows_model(*b) && divided({kOne, kTwo}, *a);
  }));
  broker_.reset();
  for (int k = 0; k < 10; ++k) {
    turn(0.001);
    a->poll(5ms);
    b->poll(5ms);
  }
  const auto newest = [](const StreamClient& viewer) {
    std::uint32_t version = 0;
    for (const auto& [page, held] : viewer.replica().held_pages()) version = std::max(version, held);
    return version;
  };
  const std::uint32_t before = std::max(newest(*a), newest(*b)) >> 18U;
  turn(3.5);
  ASSERT_TRUE(until({a.get(), b.get()}, [&] {
    turn(0.01);
    return newest(*a) >> 18U > before && newest(*b) >> 18U > before;
  }));
  EXPECT_NE(newest(*a) >> 18U, newest(*b) >> 18U);
}

}  // namespace
}  // namespace splatbus::stream_test
