// Where peers are, and what of them outlives their being viewers.
#include "streamer/peer_book.h"

#include <gtest/gtest.h>

#include "../../nanoseconds.h"
#include "stream/relay_client.h"
#include "streamer/page_readers.h"
#include "streamer/peer_address.h"

namespace splatbus::streamer {
namespace {

TEST(PeerAddress, IsThatOfANetworkOrOfThisMachine) {
  const auto text = [](const char* peer) { return parse_peer_address(peer).text; };
  EXPECT_EQ(text("192.0.2.7"), "192.0.2.7");
  EXPECT_EQ(text("::ffff:192.0.2.7"), "192.0.2.7");
  EXPECT_EQ(text("2001:db8:1:2:3:4:5:6"), text("2001:db8:1:2::9"));
  EXPECT_NE(text("2001:db8:1:2::9"), text("2001:db8:1:3::9"));
  EXPECT_EQ(text("fe80::1:2:3%eth0"), text("fe80::9"));
  for (const char* own : {"127.0.0.1", "127.9.8.7", "::1", "::ffff:127.0.0.3"}) EXPECT_EQ(text(own), "127.0.0.1");
}

TEST(PeerAddress, OverIpcIsNobodyElses) {
  EXPECT_TRUE(parse_peer_address("host:1000:1000:4242").is_local);
  EXPECT_TRUE(parse_peer_address(":0:0:1").is_local);
  for (const char* other : {"::1:2:3", "1::2:3:4", "fe80::1:1000:1000:4242", "cafe:1:2:3:4:5:6:7", "192.0.2.7", "",
                            "host:1000:1000:", "host:a:1:2"}) {
    EXPECT_FALSE(parse_peer_address(other).is_local) << other;
  }
}

TEST(RelayClient, IsReadAsItIsWritten) {
  for (const std::uint64_t client : {std::uint64_t{1}, ~std::uint64_t{0}}) {
    EXPECT_EQ(stream::parse_client_frame(stream::client_frame(client)), client);
  }
  for (const char* none :
       {"", "client ", "client x", "client 1 ", "client -1", "client 18446744073709551616", "rights"})
    EXPECT_EQ(stream::parse_client_frame(none), std::nullopt) << none;
}

TEST(BoundedBuckets, EachHasItsOwnInBoundedMemory) {
  BoundedBuckets buckets(1, 2);
  EXPECT_TRUE(buckets.take("a", 2, kSecond));
  EXPECT_FALSE(buckets.take("a", 1, kSecond));
  EXPECT_TRUE(buckets.take("b", 2, kSecond));
  EXPECT_TRUE(buckets.take("a", 1, 2 * kSecond));
  for (int k = 0; k < 5000; ++k) (void)buckets.take(std::to_string(k), 1, 2 * kSecond + k);
  EXPECT_LE(buckets.size(), BoundedBuckets::kMax);
}

TEST(PeerBook, OneThatSpeaksAllTheTimeCostsOthersNothing) {
  PeerBook book;
  std::int64_t now_ns = kSecond;
  int answered = 0, admitted = 0;
  for (int k = 0; k < 5000; ++k) {
    answered += book.answers("noisy", now_ns) ? 1 : 0;
    admitted += book.admits("noisy", "192.0.2.1", now_ns) ? 1 : 0;
    now_ns += kSecond / 5000;
  }
  EXPECT_LE(answered, 16);
  EXPECT_LE(admitted, 6);
  EXPECT_TRUE(book.answers("good", now_ns));
  EXPECT_TRUE(book.admits("good", "192.0.2.1", now_ns)) << "of the same address";
  EXPECT_TRUE(book.admits("other", "192.0.2.2", now_ns));
}

TEST(PeerBook, OneAddressLeavesOthersTheirHellos) {
  PeerBook book;
  int admitted = 0;
  for (int k = 0; k < 1000; ++k) admitted += book.admits(std::to_string(k), "192.0.2.1", kSecond) ? 1 : 0;
  EXPECT_EQ(admitted, 40) << "as many at once";
  EXPECT_TRUE(book.admits("good", "192.0.2.2", kSecond));
}

TEST(PeerBook, AnAddressThatMayHaveMoreViewersMayGreetMore) {
  PeerBook book(2 * 56);
  int admitted = 0;
  for (int k = 0; k < 1000; ++k) admitted += book.admits(std::to_string(k), "192.0.2.1", kSecond) ? 1 : 0;
  EXPECT_EQ(admitted, 2 * 40);
}

TEST(PeerBook, WhoLeavesAndComesBackHasHadWhatItHad) {
  PeerBook book;
  const auto leaver = [](std::int64_t posed_ns) {
    return PeerBook::Leaver{.limits = {}, .spent = {}, .posed_ns = posed_ns};
  };
  book.left("a", "192.0.2.1", "ann", leaver(1), kSecond);
  book.left("b", "192.0.2.1", "bob", leaver(2), kSecond);
  book.left("c", "", "cyd", leaver(3), kSecond);
  EXPECT_FALSE(book.take_leaver("x", "192.0.2.1", "eve", kSecond)) << "a neighbour owes nothing of theirs";
  EXPECT_FALSE(book.take_leaver("x", "192.0.2.2", "ann", kSecond)) << "nor who has the name elsewhere";
  EXPECT_EQ(book.take_leaver("b", "192.0.2.1", "new", kSecond)->posed_ns, 2) << "the same connection";
  EXPECT_EQ(book.take_leaver("x", "192.0.2.1", "ann", kSecond)->posed_ns, 1) << "another one of address and name";
  EXPECT_FALSE(book.take_leaver("y", "192.0.2.1", "ann", kSecond)) << "nobody else has left there";
  EXPECT_FALSE(book.take_leaver("z", "", "cyd", kSecond)) << "this user's own have no address";
  EXPECT_FALSE(book.take_leaver("c", "", "cyd", kSecond + PeerBook::kRememberNs + 1)) << "by then all is there again";
}

TEST(PeerBook, WhoTakesANewNameEachTimeIsForgivenAFew) {
  PeerBook book;
  int fresh = 0;
  for (int k = 0; k < 100; ++k) {
    const std::string name = std::to_string(k);
    const auto owed = book.take_leaver(name, "192.0.2.1", name, kSecond);
    fresh += owed ? 0 : 1;
    book.left(name, "192.0.2.1", name, owed.value_or(PeerBook::Leaver{}), kSecond);
  }
  EXPECT_EQ(fresh, PeerBook::kForgiven + 1);
}

TEST(PageReaders, WhoIsNoServiceHasAFewAndTakesNoReadersPlace) {
  PageReaders readers;
  double given = 0;
  for (int k = 0; k < 1000; ++k) given += readers.take_as_stranger("192.0.2.1", 10, kSecond + k * 1'000'000) ? 10 : 0;
  EXPECT_LE(given, PageReaders::kStrangersBurst + PageReaders::kStrangersPages_s);
  EXPECT_TRUE(readers.take_as_stranger("192.0.2.2", 10, 2 * kSecond));
  EXPECT_TRUE(readers.empty());
}

TEST(PageReaders, AnEmptyRequestMakesNoReader) {
  PageReaders readers;
  for (std::size_t k = 0; k < PageReaders::kMaxReaders; ++k) {
    EXPECT_FALSE(readers.take("empty " + std::to_string(k), 0, kSecond));
  }
  EXPECT_TRUE(readers.empty());
  EXPECT_TRUE(readers.take("gateway", 1, kSecond));
}

}  // namespace
}  // namespace splatbus::streamer
