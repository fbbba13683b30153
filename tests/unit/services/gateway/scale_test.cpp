// Streamers that share browsers: where each goes, and what it holds when one of them leaves.
#include <gmock/gmock.h>

#include <algorithm>
#include <atomic>
#include <map>
#include <nlohmann/json.hpp>

#include "gateway_fixture.h"
#include "stream/follower.h"
#include "viewer/stream_client.h"
#include "wire/system_generated.h"

namespace splatbus::gateway_test {
namespace {

/// A browser's part in the protocol, as the page has it.
class Page {
 public:
  explicit Page(std::uint16_t port, const std::string& name)
      : socket_(port), follower_({.name = name, .hello_every_ns = 50'000'000}, bus::now_ns()) {}

  void poll() {
    while (const auto packet = follower_.next_outgoing(bus::now_ns())) socket_.send_packet(packet->packet);
    const auto message = socket_.receive(5ms);
    if (!message) return;
    const auto framed = stream::take_apart({reinterpret_cast<const std::uint8_t*>(message->data()), message->size()});
    // What came behind another one that is lost, or of a streamer that is left, is refused without harm.
    try {
      follower_.receive(framed.packet, framed.payload, bus::now_ns());
    } catch (const stream::StreamError&) {
    }
    ever_empty_ = ever_empty_ || (shown_ && replica().count() == 0);
    shown_ = shown_ || replica().count() > 0;
  }
  [[nodiscard]] const stream::Replica& replica() const { return follower_.replica(); }
  [[nodiscard]] bool holds(std::size_t count) const {
    return replica().count() == count && replica().missing_pages() == 0;
  }
  /// Whether its picture has been without Gaussians since it had some.
  [[nodiscard]] bool ever_empty() const { return ever_empty_; }

 private:
  WebSocketClient socket_;
  stream::Follower follower_;
  bool shown_ = false, ever_empty_ = false;
};

class Shared : public GatewayTest {
 protected:
  Shared() : observer_(connect("observer")) {
    observer_.on(topics::kStreamerOffer, [this](const wire::StreamerOffer& offer, const bus::Message& message) {
      offers_[message.header().source()->str()] = {offer.viewers(), offer.draining()};
    });
  }
  std::unique_ptr<stream_test::RunningStreamer> streamer(const std::string& name) {
    return std::make_unique<stream_test::RunningStreamer>(
        connect(name), std::vector<std::pair<std::string, std::string>>{{"tick_hz", "20"}, {"drain_s", "20"}});
  }
  void open_pages(int count) {
    for (int i = 0; i < count; ++i) pages_.push_back(std::make_unique<Page>(port_, "page " + std::to_string(i)));
  }
  bool until(const std::function<bool()>& condition) {
    const auto deadline = std::chrono::steady_clock::now() + bus_test::patience;
    while (!condition()) {
      observer_.dispatch_all(0ms);
      if (mortal_) mortal_->turn(0.02);
      for (const auto& page : pages_) page->poll();
      if (std::chrono::steady_clock::now() > deadline) return false;
    }
    return true;
  }
  [[nodiscard]] bool all_hold(std::size_t count) const {
    return std::ranges::all_of(pages_, [&](const auto& page) { return page->holds(count); });
  }
  [[nodiscard]] std::uint32_t viewers(const std::string& name) const {
    const auto found = offers_.find(name);
    return found == offers_.end() ? 0 : found->second.first;
  }

  bus::Subscriber observer_;
  std::map<std::string, std::pair<std::uint32_t, bool>> offers_;
  std::vector<std::unique_ptr<Page>> pages_;
  std::unique_ptr<stream_test::SteppedStreamer> mortal_;  ///< turns while somebody waits; its end is a death
};

TEST_F(Shared, TwoStreamersShareBrowsersAndOneThatEndsHandsItsOwnOver) {
  auto first = streamer("streamer-1"), second = streamer("streamer-2");
  trainer_.publish(stream::test::toy_model(2000, 1));
  start_gateway("");
  ASSERT_TRUE(until([&] { return offers_.size() == 2; }));
  open_pages(6);
  ASSERT_TRUE(until([&] { return all_hold(2000) && viewers("streamer-1") == 3 && viewers("streamer-2") == 3; }));
  first.reset();  // as on SIGTERM: it waits for them to go
  EXPECT_TRUE(offers_.contains("streamer-1"));
  trainer_.publish(stream::test::toy_model(2500, 1));
  ASSERT_TRUE(until([&] { return all_hold(2500) && viewers("streamer-2") == 6; }));
  for (const auto& page : pages_) EXPECT_FALSE(page->ever_empty()) << "the picture stands meanwhile";
}

TEST_F(Shared, WhoeverTheDeadOneServedIsServedByTheOther) {
  const auto second = streamer("streamer-2");
  // One process, that is one connection: the broker lets no second one speak by the name.
  const auto process = connect("streamer-1");
  mortal_ = std::make_unique<stream_test::SteppedStreamer>(process, std::vector<std::pair<std::string, std::string>>{});
  const bus::Publisher heart(process);
  const auto beat = [&] {
    heart.publish(topics::kHeartbeat, {.latch_key = "streamer-1"}, [](auto& builder, auto header) {
      return wire::CreateHeartbeatDirect(builder, header, "streamer", 1, wire::ServiceState::Running);
    });
    return true;
  };
  trainer_.publish(stream::test::toy_model(2000, 1));
  start_gateway("");
  ASSERT_TRUE(until([&] { return beat() && offers_.size() == 2; }));
  open_pages(4);
  ASSERT_TRUE(
      until([&] { return beat() && all_hold(2000) && viewers("streamer-1") == 2 && viewers("streamer-2") == 2; }));
  mortal_.reset();
  trainer_.publish(stream::test::toy_model(2500, 1));
  ASSERT_TRUE(until([&] { return all_hold(2500) && viewers("streamer-2") == 4; }));
  for (const auto& page : pages_) EXPECT_FALSE(page->ever_empty()) << "the picture stands meanwhile";
}

TEST_F(Shared, PagesOverHttpComeFromTheOtherStreamer) {
  const auto named = [&]() -> std::size_t {
    const auto manifest = nlohmann::json::parse(get(port_, "/manifest.json").body, nullptr, false);
    return manifest.is_object() ? manifest.value("gaussians", std::size_t{0}) : 0;
  };
  trainer_.freeze(true);
  auto first = streamer("streamer-1");
  trainer_.publish(stream::test::toy_model(1500, 1));
  start_gateway("");
  ASSERT_TRUE(until([&] { return named() == 1500; }));
  const auto second = streamer("streamer-2");
  ASSERT_TRUE(until([&] { return offers_.size() == 2; }));
  first.reset();
  trainer_.publish(stream::test::toy_model(1700, 1));
  ASSERT_TRUE(until([&] { return named() == 1700; }));
  const auto manifest = nlohmann::json::parse(get(port_, "/manifest.json").body);
  for (const auto& page : manifest["pages"]) EXPECT_EQ(get(port_, page["path"]).status, 200) << page["path"];
}

// That it has no key for, and no place at all.
TEST_F(Shared, AnOfferThatCannotBeTakenIsPassedOver) {
  const bus::Publisher far(connect("streamer-far")), nowhere(connect("streamer-nowhere"));
  const auto offer = [](const bus::Publisher& publisher, const std::string& source, const char* endpoint) {
    publisher.publish(topics::kStreamerOffer, {.latch_key = source}, [&](auto& builder, auto header) {
      return wire::CreateStreamerOffer(builder, header,
                                       builder.CreateVectorOfStrings(std::vector<std::string>{endpoint}), 0, 64, 200);
    });
  };
  const auto lie = [&] {
    offer(far, "streamer-far", "tcp://192.0.2.1:7600");
    offer(nowhere, "streamer-nowhere", "tcp://nobody:99999999");
    return true;
  };
  start_gateway("");
  ASSERT_TRUE(until([&] { return lie() && offers_.size() == 2; }));
  open_pages(1);                                              // while there is no other
  const std::int64_t until_ns = bus::now_ns() + 500'000'000;  // in which the gateway looks for streamers some times
  ASSERT_TRUE(until([&] { return lie() && bus::now_ns() > until_ns; }));
  const auto good = streamer("streamer-of-all-last");
  trainer_.publish(stream::test::toy_model(1500, 1));
  ASSERT_TRUE(until([&] { return lie() && offers_.size() == 3; }));
  open_pages(3);
  ASSERT_TRUE(until([&] { return lie() && all_hold(1500) && viewers("streamer-of-all-last") == 4; }));
  EXPECT_EQ(get(port_, "/status").status, 200);
}

/// A native viewer, which asks the bus itself.
TEST_F(Shared, ANativeViewerFindsAnotherStreamer) {
  auto first = streamer("streamer-1");
  trainer_.publish(stream::test::toy_model(1000, 1));
  stream::StreamerFinder finder(connect("viewer"));
  viewer::StreamClient client({.endpoint = "ipc://" + directory_.path() + "/streamer",
                               .find_endpoint = [&] { return finder.endpoint(bus::now_ns()); },
                               .name = "viewer"});
  ASSERT_TRUE(poll_until([&] { return client.replica().count() == 1000; }, client));
  const auto second = streamer("streamer-2");
  ASSERT_TRUE(until([&] { return offers_.size() == 2; }));
  std::atomic<bool> ended = false;
  std::thread end([&] {
    first.reset();
    ended = true;
  });
  EXPECT_TRUE(poll_until([&] { return ended.load(); }, client));
  end.join();
  trainer_.publish(stream::test::toy_model(1200, 1));
  EXPECT_TRUE(poll_until([&] { return client.replica().count() == 1200; }, client));
}

}  // namespace
}  // namespace splatbus::gateway_test
