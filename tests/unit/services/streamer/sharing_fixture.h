#pragma once

#include <algorithm>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "streamer_fixture.h"
#include "wire/share_generated.h"
#include "wire/share_topics.h"

namespace splatbus::stream_test {

/// Streamers of one bus, viewers of theirs, and somebody who listens to what streamers say to each other.
class SharingTest : public StreamerTest {
 protected:
  using Changes = std::vector<std::pair<std::string, std::string>>;
  inline static const std::string kOne = "streamer-1", kTwo = "streamer-2";

  SharingTest() : listener_(connect("listener")) {
    listener_.on(topics::kStreamShare, [this](const wire::StreamShare& body, const bus::Message& message) {
      Said& said = said_[message.header().source()->str()];
      ++said.messages;
      said.epoch = body.stream_epoch();
      if (body.has_pages()) {
        said.pages.clear();
        for (const wire::SharePage* page : *body.pages()) said.pages.insert(page->page());
      }
      if (!body.packets()) return;
      for (const wire::SharePacket* packet : *body.packets()) ++(packet->answer() ? said.answers : said.deltas);
    });
    EXPECT_TRUE(listener_.wait_connected(std::chrono::duration_cast<std::chrono::milliseconds>(bus_test::patience)));
  }

  static Changes changes_of(const Changes& changes) {
    Changes all{{"tick_hz", "20"}, {"coarseness", "-20"}, {"budget_kbps", "1000000"}, {"viewer_kbps", "1000000"}};
    all.insert(all.end(), changes.begin(), changes.end());
    return all;
  }
  std::unique_ptr<RunningStreamer> streamer(const std::string& name, const Changes& changes = {}) {
    return std::make_unique<RunningStreamer>(connect(name), changes_of(changes));
  }
  std::unique_ptr<StreamClient> viewer_at(const std::string& endpoint, const std::string& name = "viewer") const {
    return std::make_unique<StreamClient>(viewer::ClientOptions{.endpoint = endpoint,
                                                                .name = name,
                                                                .hello_every_ns = 20'000'000,
                                                                .silence_ns = 20'000'000'000,
                                                                .pose_every_ns = 0});
  }
  std::unique_ptr<StreamClient> viewer_of(const RunningStreamer& streamer) const {
    return viewer_at(streamer.endpoints().front());
  }

  /// Polls all viewers, listens, and turns what the test's clock moves: by as much as has passed at least, for who
  /// shares with it has the real one, and takes it for gone when it is silent for 3 s of that.
  bool until(const std::vector<StreamClient*>& viewers, const std::function<bool()>& condition) {
    const auto deadline = std::chrono::steady_clock::now() + bus_test::patience;
    auto turned = std::chrono::steady_clock::now();
    while (!condition()) {
      listener_.dispatch_all(0ms);
      const auto now = std::chrono::steady_clock::now();
      const double passed_s = std::chrono::duration<double>(now - std::exchange(turned, now)).count();
      if (stepped_) stepped_->turn(std::max(0.01, passed_s));
      for (StreamClient* viewer : viewers) viewer->poll(5ms);
      if (std::chrono::steady_clock::now() > deadline) return false;
    }
    return true;
  }
  /// The model moves all the time for so long.
  void train(const std::vector<StreamClient*>& viewers, std::chrono::milliseconds time, float amount = 0.1F) {
    std::normal_distribution<float> step(0, amount);
    const auto end = std::chrono::steady_clock::now() + time;
    auto next = std::chrono::steady_clock::now();
    ASSERT_TRUE(until(viewers, [&] {
      const auto now = std::chrono::steady_clock::now();
      if (now >= next) {
        for (float& value : model_.parameters) value += step(random_);
        trainer_.publish(model_);
        next = now + 50ms;
      }
      return now > end;
    }));
  }
  /// Whether it shows each Gaussian where the model has it.
  [[nodiscard]] bool shows_model(const StreamClient& viewer) const {
    return viewer.replica().count() == model_.count() && viewer.replica().missing_pages() == 0 &&
           ids_by_row(viewer.replica(), model_).size() == model_.count();
  }
  /// Whether what these encode is all that the viewer has, and nothing twice.
  [[nodiscard]] bool divided(const std::vector<std::string>& names, const StreamClient& viewer) const {
    std::set<std::uint32_t> all;
    std::size_t each = 0;
    for (const std::string& name : names) {
      const auto found = said_.find(name);
      if (found == said_.end() || found->second.pages.empty()) return false;
      all.insert(found->second.pages.begin(), found->second.pages.end());
      each += found->second.pages.size();
    }
    std::set<std::uint32_t> held;
    for (const auto& [page, version] : viewer.replica().held_pages()) held.insert(page);
    return each == all.size() && all == held;
  }

  struct Said {
    std::set<std::uint32_t> pages;
    std::uint64_t epoch = 0;
    std::size_t messages = 0, answers = 0, deltas = 0;  ///< packets: pages and visibility that were asked for; others
  };
  bus::Subscriber listener_;
  std::map<std::string, Said> said_;
  GaussiansBuffer model_ = stream::test::toy_model(12'000, 1);
  std::mt19937 random_{3};
  std::unique_ptr<SteppedStreamer> stepped_;
};

}  // namespace splatbus::stream_test
