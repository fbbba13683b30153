// Replicas that stop, that were stuck, that leave, and what is no word of a replica.
#include <thread>

#include "sharing_fixture.h"
#include "wire/system_generated.h"

namespace splatbus::stream_test {
namespace {

/// A running one, one under the test's clock, and a viewer of the running one.
class SharingFaults : public SharingTest {
 protected:
  void SetUp() override {
    one_ = streamer(kOne);
    stepped_ = std::make_unique<SteppedStreamer>(process_, changes_of({}));
    trainer_.publish(model_);
    viewer_ = viewer_of(*one_);
    ASSERT_TRUE(until({viewer_.get()}, [&] { return shows_model(*viewer_) && divided({kOne, kTwo}, *viewer_); }));
    epoch_ = viewer_->replica().epoch();
  }
  /// Whether the picture was whole, in the same stream, all the time until then.
  bool stands_until(const std::function<bool()>& condition) {
    bool stood = true;
    const bool came = until({viewer_.get()}, [&] {
      stood = stood && viewer_->replica().count() == model_.count() && viewer_->replica().epoch() == epoch_;
      return condition();
    });
    EXPECT_TRUE(stood);
    return came;
  }
  void move_model() {
    disturb(model_, random_);
    trainer_.publish(model_);
  }

  void beat(wire::ServiceState state) {
    const bus::Publisher heart(process_);
    heart.publish(topics::kHeartbeat, {.latch_key = kTwo}, [&](auto& builder, auto header) {
      return wire::CreateHeartbeatDirect(builder, header, "streamer", 1, state);
    });
  }

  [[nodiscard]] float mean_step() const {
    return viewer_->replica().held().layout.at(stream::Attribute::Mean).quantizer.step;
  }

  std::shared_ptr<bus::Context> process_ = connect(kTwo);  // one connection: that is one process to the broker
  std::unique_ptr<RunningStreamer> one_;
  std::unique_ptr<StreamClient> viewer_;
  std::uint64_t epoch_ = 0;
};

TEST_F(SharingFaults, PagesOfOneThatDiesAreTheOthers) {
  stepped_.reset();
  move_model();
  ASSERT_TRUE(stands_until([&] { return shows_model(*viewer_) && divided({kOne}, *viewer_); }));
  EXPECT_EQ(viewer_->refused(), 0U);
}

/// Between the moment at which it is known to be gone and the tick that makes its pages anew, however long that takes.
TEST_F(SharingTest, PagesOfOneThatIsGoneStayUntilTheyAreMadeAnew) {
  SteppedStreamer one(connect(kOne), changes_of({}));
  auto two = std::make_unique<SteppedStreamer>(connect(kTwo), changes_of({}));
  trainer_.publish(model_);
  const auto viewer = viewer_at(one.endpoint());
  int passed_ms = 0;
  const auto turn = [&](int ms) {
    one.turn(ms * 1e-3);
    if (two) two->turn(ms * 1e-3);
    passed_ms += ms;
  };
  ASSERT_TRUE(until({viewer.get()}, [&] {
    turn(20);
    return shows_model(*viewer) && divided({kOne, kTwo}, *viewer);
  }));
  turn(60 - passed_ms % 50);  // 10 ms after a tick's time
  const std::size_t said = said_[kTwo].messages;
  two->turn(1);
  ASSERT_TRUE(until({viewer.get()}, [&] {
    one.turn(0);
    return said_[kTwo].messages > said;
  }));
  two.reset();
  bool stood = true;
  const auto wait = [&] {
    for (int k = 0; k < 20; ++k) {
      one.turn(0);
      viewer->poll(5ms);
      stood = stood && viewer->replica().count() == model_.count();
    }
  };
  wait();  // the last that it said is heard, at this time
  turn(3000);
  turn(1);   // it is gone
  turn(14);  // and what the last tick has made goes to viewers, before the next one
  wait();
  EXPECT_TRUE(stood);
  ASSERT_TRUE(until({viewer.get()}, [&] {
    turn(20);
    stood = stood && viewer->replica().count() == model_.count();
    return shows_model(*viewer) && divided({kOne}, *viewer);
  }));
  EXPECT_TRUE(stood);
}

/// Those that another heir makes anew stay until that one has said so.
TEST_F(SharingTest, PagesOfOneThatIsGoneStayUntilAnyHeirHasMadeThemAnew) {
  const std::string three_name = "streamer-3";
  SteppedStreamer one(connect(kOne), changes_of({})), two(connect(kTwo), changes_of({}));
  auto three = std::make_unique<SteppedStreamer>(connect(three_name), changes_of({}));
  trainer_.publish(model_);
  const auto viewer = viewer_at(one.endpoint());
  ASSERT_TRUE(until({viewer.get()}, [&] {
    for (SteppedStreamer* each : {&one, &two, three.get()}) each->turn(0.02);
    return shows_model(*viewer) && divided({kOne, kTwo, three_name}, *viewer);
  }));
  three.reset();
  bool stood = true;
  const auto look = [&] {
    for (int k = 0; k < 4; ++k) {
      one.turn(0);
      viewer->poll(2ms);
      stood = stood && viewer->replica().count() == model_.count();
    }
  };
  // The other heir is in the middle of a tick when it is known.
  for (int ms = 0; ms < 3100; ms += 10) {
    one.turn(0.01);
    if (ms < 2900) two.turn(0.01);
    look();
  }
  EXPECT_TRUE(stood);
  ASSERT_TRUE(until({viewer.get()}, [&] {
    one.turn(0.02);
    two.turn(0.02);
    look();
    return shows_model(*viewer) && divided({kOne, kTwo}, *viewer);
  }));
  EXPECT_TRUE(stood);
}

TEST_F(SharingFaults, OneThatWasStuckTakesItsPagesBack) {
  const std::set<std::uint32_t> before = said_[kTwo].pages;
  auto stuck = std::exchange(stepped_, nullptr);
  move_model();
  ASSERT_TRUE(stands_until([&] { return shows_model(*viewer_) && divided({kOne}, *viewer_); }));
  stepped_ = std::move(stuck);
  move_model();
  ASSERT_TRUE(stands_until([&] { return divided({kOne, kTwo}, *viewer_) && shows_model(*viewer_); }));
  EXPECT_EQ(said_[kTwo].pages, before);
  for (int k = 0; k < 5; ++k) {
    move_model();
    ASSERT_TRUE(stands_until([&] { return shows_model(*viewer_); }));
  }
  EXPECT_EQ(viewer_->refused(), 0U);
}

TEST_F(SharingFaults, WhatTheBrokerKnowsToHaveEndedIsNotWaitedFor) {
  beat(wire::ServiceState::Running);
  ASSERT_TRUE(stands_until([&] { return shows_model(*viewer_); }));
  stepped_.reset();
  beat(wire::ServiceState::Stopping);
  move_model();
  // Under its name somebody goes on to speak: by silence nobody would ever know.
  const bus::Publisher echo(process_);
  std::uint32_t version = 0;
  for (const auto& [page, held] : viewer_->replica().held_pages()) version = std::max(version, held);
  ASSERT_TRUE(stands_until([&] {
    echo.publish(topics::kStreamShare, [&](auto& builder, auto header) {
      const auto none = builder.CreateVectorOfStructs(std::vector<wire::SharePage>());
      return wire::CreateStreamShare(builder, header, epoch_, wire::Appearance::Transfer, 0, mean_step(), true, false,
                                     version, false, 0, 0, 0, false, none, 0, 0);
    });
    return shows_model(*viewer_);
  }));
}

TEST_F(SharingFaults, WhoSaysWhatCannotBeTakesNoPage) {
  const bus::Publisher liar(connect("streamer-9"));
  const auto claim = [&](std::uint32_t gaussians) {
    liar.publish(topics::kStreamShare, [&](auto& builder, auto header) {
      std::vector<wire::SharePage> pages;
      for (std::uint32_t page = 0; page < 20; ++page) {
        pages.emplace_back(page, 4'000'000'000U, 1, page < 19 ? 1 : gaussians, 0, wire::PageBox(), 0, false);
      }
      const auto pages_at = builder.CreateVectorOfStructs(pages);
      return wire::CreateStreamShare(builder, header, epoch_, wire::Appearance::Transfer, 0, mean_step(), true, false,
                                     4'000'000'001U, false, 0, 0, 0, true, pages_at, 0, 0);
    });
  };
  for (int k = 0; k < 50; ++k) {
    claim(kPageLanes + 1);
    if (k % 10 == 0) move_model();
    const auto end = std::chrono::steady_clock::now() + 20ms;
    ASSERT_TRUE(stands_until([&] { return std::chrono::steady_clock::now() > end; }));
  }
  EXPECT_TRUE(stands_until([&] { return shows_model(*viewer_) && divided({kOne, kTwo}, *viewer_); }));
  // The same without what cannot be is believed: it is whose the pages are that changes.
  EXPECT_TRUE(until({viewer_.get()}, [&] {
    claim(1);
    return !divided({kOne, kTwo}, *viewer_);
  }));
}

TEST_F(SharingFaults, OneThatLeavesGivesItsPagesAway) {
  stepped_.reset();
  auto two = streamer("streamer-3", {{"drain_s", "20"}});
  auto b = viewer_of(*two);
  ASSERT_TRUE(until({viewer_.get(), b.get()}, [&] {
    return shows_model(*b) && shows_model(*viewer_) && divided({kOne, "streamer-3"}, *viewer_);
  }));
  std::thread ending([&] { two.reset(); });  // it waits for its viewer to go
  move_model();
  EXPECT_TRUE(until({viewer_.get(), b.get()}, [&] {
    return said_["streamer-3"].pages.empty() && divided({kOne}, *b) && shows_model(*b) && shows_model(*viewer_);
  }));
  train({viewer_.get(), b.get()}, 300ms);
  EXPECT_TRUE(until({viewer_.get(), b.get()}, [&] { return shows_model(*b) && shows_model(*viewer_); }));
  EXPECT_EQ(b->refused(), 0U);
  b.reset();
  ending.join();
}

/// A viewer that does not leave keeps nobody until he is killed for it.
TEST_F(SharingFaults, ADrainEndsBeforeItsProcessIsKilled) {
  ASSERT_EQ(::setenv("SPLATBUS_STOP_TIMEOUT_S", "2", 1), 0);
  EXPECT_LE(streamer::drain_limit_s(20), 1.5);
  EXPECT_EQ(streamer::drain_limit_s(1), 1);
  stepped_.reset();
  auto two = streamer("streamer-3", {{"drain_s", "20"}});
  auto b = viewer_of(*two);
  ASSERT_TRUE(until({viewer_.get(), b.get()}, [&] { return shows_model(*b) && shows_model(*viewer_); }));
  const auto start = std::chrono::steady_clock::now();
  two.reset();
  const double took_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  ::unsetenv("SPLATBUS_STOP_TIMEOUT_S");
  EXPECT_GE(took_s, 1.4) << "it did wait for its viewer";
  EXPECT_LT(took_s, 10);
  EXPECT_EQ(streamer::drain_limit_s(20), 20) << "nobody kills it";
}

}  // namespace
}  // namespace splatbus::stream_test
