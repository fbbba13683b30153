// Those who ask a hub for pages of a large world, and read slowly or not at all.
#include <gtest/gtest.h>

#include <numeric>

#include "../../bus/bus_fixture.h"
#include "../../nanoseconds.h"
#include "../../stream/toy_server.h"
#include "streamer/viewer_hub.h"

namespace splatbus::streamer {
namespace {

using namespace std::chrono_literals;

/// A gateway's connection that holds next to nothing unread.
class SlowReader {
 public:
  SlowReader(zmq::context_t& context, const std::string& endpoint) : socket_(context, zmq::socket_type::dealer) {
    socket_.set(zmq::sockopt::linger, 0);
    socket_.set(zmq::sockopt::rcvhwm, 1);
    socket_.connect(endpoint);
  }
  void ask(bool manifest, const std::vector<wire::PageVersion>& wanted = {}, std::uint64_t epoch = 0) {
    const auto packet = writer_.write(epoch, 0, wire::Body::PageRequest, [&](auto& b) {
      return wire::CreatePageRequest(b, manifest, b.CreateVectorOfStructs(wanted));
    });
    socket_.send(zmq::buffer(packet.packet), zmq::send_flags::none);
  }
  /// One packet, where there is one.
  bool read() {
    zmq::message_t packet, payload;
    if (!socket_.recv(packet, zmq::recv_flags::dontwait)) return false;
    if (packet.more()) (void)socket_.recv(payload);
    const auto parsed = stream::ParsedPacket::parse({packet.data<std::uint8_t>(), packet.size()},
                                                    {payload.data<std::uint8_t>(), payload.size()});
    take(parsed.root());
    return true;
  }

  int layouts = 0, begun = 0, ended = 0;  ///< manifests
  std::vector<std::uint32_t> named;       ///< by the one that was begun last
  std::vector<std::uint32_t> pages, gone;
  int ended_before_pages = 0;

 private:
  void take(const wire::Packet& root) {
    layouts += root.body_type() == wire::Body::Layout ? 1 : 0;
    if (const auto* body = root.body_as_Manifest()) {
      if (body->whole()) {
        ++begun;
        named.clear();
      }
      ended += body->more() ? 0 : 1;
      for (const wire::PageInfo* page : *body->pages()) named.push_back(page->page());
    }
    if (const auto* body = root.body_as_Page()) {
      pages.push_back(body->page());
      ended_before_pages = ended;
    }
    if (const auto* body = root.body_as_PagesGone())
      gone.insert(gone.end(), body->pages()->begin(), body->pages()->end());
  }

  zmq::socket_t socket_;
  stream::PacketWriter writer_{"reader", 1};
};

/// Of a model with some pages, and other replicas with many.
class PageAnswersTest : public testing::Test {
 protected:
  PageAnswersTest() {
    EXPECT_TRUE(model_.observe(stream::test::toy_model(20'000, 1).view()));
    model_.reset_to_target();
  }
  void offer(std::uint32_t pages) {
    std::vector<stream::OfferedPage> all = *model_.offered();
    ASSERT_GE(all.size(), 3U);
    BoardPages offered;
    for (std::uint32_t number = all.back().page + 1; all.size() < pages; ++number) {
      all.push_back({.page = number, .version = 1, .structure = 1, .count = 1000, .frozen = true, .bounds = {}});
      offered.of_others.push_back(number);
    }
    numbers_.clear();
    for (const stream::OfferedPage& page : all) numbers_.push_back(page.page);
    offered.all = std::make_shared<const std::vector<stream::OfferedPage>>(std::move(all));
    hub_.restart_all(std::move(offered));
  }
  [[nodiscard]] SlowReader reader() { return {context_, endpoint_.bound()[0]}; }
  bool pump() {
    now_ns_ += kSecond / 200;
    hub_.receive(now_ns_);
    return hub_.pump(now_ns_);
  }
  /// A packet a turn.
  bool read_slowly_until(SlowReader& one, const std::function<bool()>& done) {
    return bus_test::eventually([&] { return pump(), one.read(), done(); }, 20s);
  }

  bus_test::TemporaryDirectory directory_;
  zmq::context_t context_;
  Endpoint endpoint_{{"ipc://" + directory_.path() + "/streamer"}};
  stream::StreamModel model_{stream::PacketWriter("streamer", 1), 77, stream::StreamOptions{}};
  ViewerHub hub_{endpoint_, model_, stream::PacketWriter("streamer", 1), HubOptions{}, HubEvents{}};
  std::int64_t now_ns_ = kSecond;
  std::vector<std::uint32_t> numbers_;
};

TEST_F(PageAnswersTest, ASlowReaderGetsTheManifestOfALargeWorldWhole) {
  offer(10'000);
  SlowReader one = reader();
  one.ask(true);
  ASSERT_TRUE(read_slowly_until(one, [&] { return one.ended > 0; })) << one.named.size() << " pages";
  EXPECT_EQ(one.layouts, 1);
  EXPECT_EQ(one.begun, 1);
  EXPECT_EQ(one.named, numbers_) << "all of them, in order";
}

TEST_F(PageAnswersTest, PagesComeBehindTheManifestThatWasAskedForBefore) {
  offer(10'000);
  SlowReader one = reader();
  std::vector<wire::PageVersion> wanted;
  for (const stream::OfferedPage& page : *model_.offered()) wanted.emplace_back(page.page, page.version);
  const std::uint32_t last = wanted.back().page();
  wanted.insert(wanted.begin() + 1, {{4'000'000, 1}, {4'000'001, 1}});
  const std::size_t pages = wanted.size() - 2;
  one.ask(true, wanted, model_.status().epoch);
  ASSERT_TRUE(read_slowly_until(one, [&] { return one.pages.size() == pages; })) << one.pages.size() << " pages";
  EXPECT_EQ(one.ended_before_pages, 1);
  EXPECT_EQ(one.pages.back(), last);
  EXPECT_EQ(one.gone, (std::vector<std::uint32_t>{4'000'000, 4'000'001}));
}

TEST_F(PageAnswersTest, WhoAsksAgainMeanwhileIsSentOneManifest) {
  offer(20'000);
  SlowReader one = reader();
  one.ask(true);
  one.ask(true);
  ASSERT_TRUE(bus_test::eventually([&] { return pump(); }));
  ASSERT_TRUE(read_slowly_until(one, [&] { return one.ended > 0; })) << one.named.size() << " pages";
  for (int turn = 0; turn < 20; ++turn) {
    pump();
    one.read();
    std::this_thread::sleep_for(2ms);
  }
  EXPECT_EQ(one.begun, 1);
  EXPECT_EQ(one.named, numbers_);
}

TEST_F(PageAnswersTest, WhoNeverReadsIsGivenUp) {
  offer(20'000);
  SlowReader one = reader();
  one.ask(true);
  ASSERT_TRUE(bus_test::eventually([&] { return pump(); })) << "there is more than a socket holds";
  now_ns_ += 6 * kSecond;
  EXPECT_FALSE(pump());
  // Whoever has begun to read again is answered again.
  ASSERT_TRUE(bus_test::eventually([&] { return one.read(), pump(), one.named.size() > 6'000; }));
  while (one.read()) std::this_thread::sleep_for(5ms);
  EXPECT_LT(one.named.size(), numbers_.size());
  one.named.clear();
  one.ask(true);
  EXPECT_TRUE(read_slowly_until(one, [&] { return one.named.size() == numbers_.size(); }));
}

TEST_F(PageAnswersTest, OfAStreamThatBeganAnewIsTheManifestThatIsSent) {
  offer(20'000);
  SlowReader one = reader();
  one.ask(true);
  ASSERT_TRUE(bus_test::eventually([&] { return pump(); }));
  offer(9'000);
  one.ask(true);  // behind what is in the socket
  ASSERT_TRUE(read_slowly_until(one, [&] { return one.ended > 0; })) << one.named.size() << " pages";
  EXPECT_EQ(one.named, numbers_);
}

TEST_F(PageAnswersTest, OneReaderThatDoesNotReadKeepsNoOtherWaiting) {
  offer(20'000);
  SlowReader stuck = reader(), good = reader();
  stuck.ask(true);
  ASSERT_TRUE(bus_test::eventually([&] { return pump(); }));
  good.ask(true);
  EXPECT_TRUE(read_slowly_until(good, [&] { return good.ended > 0; }));
  EXPECT_EQ(good.named, numbers_);
}

TEST_F(PageAnswersTest, AWorldOfAnySizeHasAManifestThatCanBeAskedFor) {
  offer(60'000);
  SlowReader one = reader();
  one.ask(true);
  EXPECT_TRUE(read_slowly_until(one, [&] { return one.ended > 0; })) << hub_.ignored() << " ignored";
  EXPECT_EQ(one.named, numbers_);
}

}  // namespace
}  // namespace splatbus::streamer
