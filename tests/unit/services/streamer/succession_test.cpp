// A streamer that comes after another one.
#include "streamer_fixture.h"
#include "wire/viewer_generated.h"

namespace splatbus::stream_test {
namespace {

/// As an operator restarts or swaps it: viewers hold what they held, and follow the next one by deltas.
TEST_F(StreamerTest, TheNextStreamerGoesOnWithTheStream) {
  start_streamer();
  const GaussiansBuffer all = stream::test::toy_model(3150, 1);
  const auto first_of_all = [&](std::size_t count) {
    GaussiansBuffer some = all;
    some.resize(count);
    return some;
  };
  {
    // The broker keeps the last offer of one that is long gone.
    const auto gone = connect("streamer-9");
    ASSERT_TRUE(gone->wait_connected(bus_test::patience));
    bus::Publisher(gone).publish(topics::kStreamerOffer, {.latch_key = "streamer-9"}, [](auto& builder, auto header) {
      const std::vector<flatbuffers::Offset<flatbuffers::String>> endpoints{builder.CreateString("ipc:///nowhere")};
      return wire::CreateStreamerOfferDirect(builder, header, &endpoints, 0, 64);
    });
    bus::Subscriber offers(observer_, {"stream/offer"});
    ASSERT_TRUE(wait_message<wire::StreamerOffer>(
        offers, "StreamerOffer/1", [](const auto& body) { return body.header()->source()->str() == "streamer-9"; }));
  }
  trainer_.publish(first_of_all(3000));
  StreamClient client(client_options("one"));
  ASSERT_TRUE(poll_until([&] { return client.replica().count() == 3000; }, client));
  const std::uint64_t epoch = client.replica().epoch(), whole_bytes = client.received_bytes();
  for (std::size_t count = 3050; count <= 3150; count += 50) {
    streamer_.reset();
    start_streamer();
    trainer_.publish(first_of_all(count));
    ASSERT_TRUE(poll_until([&] { return client.replica().count() == count; }, client));
    EXPECT_EQ(client.replica().epoch(), epoch);
  }
  EXPECT_LT(client.received_bytes() - whole_bytes, whole_bytes / 2) << "what it holds did not come again, not once";
  EXPECT_GT(ids_by_row(client.replica(), all).size(), 3140U) << "some share a place";
  StreamClient late(client_options("late"));
  EXPECT_TRUE(poll_until([&] { return hold_the_same(client.replica(), late.replica()); }, client, late));
}

TEST_F(StreamerTest, ThePictureStaysWhenAStreamerComesThatKnowsNothing) {
  start_streamer();
  trainer_.publish(stream::test::toy_model(300, 1));
  StreamClient client(client_options("one"));
  ASSERT_TRUE(poll_until([&] { return client.replica().count() == 300; }, client));
  const std::uint64_t epoch = client.replica().epoch();
  kill_streamer();
  bool vanished = false;
  const auto watch = [&] { vanished = vanished || client.replica().count() == 0; };
  start_streamer();
  GaussiansBuffer model = stream::test::toy_model(300, 1);
  grow(model, 50, 9);
  trainer_.publish(model);
  EXPECT_TRUE(poll_until([&] { return watch(), client.replica().epoch() != epoch && client.replica().count() == 350; },
                         client));
  EXPECT_FALSE(vanished);
}

}  // namespace
}  // namespace splatbus::stream_test
