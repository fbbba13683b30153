// Frozen pages and the manifest of them over HTTP.
#include <array>
#include <cstring>

#include "gateway/page_library.h"
#include "gateway/partial_content.h"
#include "gateway_fixture.h"
#include "stream/replica.h"

namespace splatbus::gateway_test {
namespace {

using gateway::PageLibrary;
using gateway::PageName;
using gateway::PartialContent;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

TEST(PagePath, HasOneSpellingOnly) {
  const PageName name{.epoch = 0xabc, .page = 17, .version = 4000000000U};
  EXPECT_EQ(gateway::path_of(name), "/page/0000000000000abc/17/4000000000");
  EXPECT_EQ(gateway::parse_page_path(gateway::path_of(name)), name);
  for (const char* wrong :
       {"/page/", "/page/abc/17/1", "/page/0000000000000ABC/17/1", "/page/0000000000000abc/017/1",
        "/page/0000000000000abc/17/01", "/page/0000000000000abc/+17/1", "/page/0000000000000abc/17/",
        "/page/0000000000000abc//1", "/page/0000000000000abc/17", "/page/0000000000000abc/17/1/",
        "/page/0000000000000abc/4294967296/1", "/page/0000000000000abc/17/1 ", "/pages/0000000000000abc/17/1"}) {
    EXPECT_EQ(gateway::parse_page_path(wrong), std::nullopt) << wrong;
  }
}

TEST(PartialContent, IsOneRangeAndNothingElse) {
  const auto part = [](const char* range, std::size_t bytes) {
    const PartialContent content = gateway::partial_content(range, bytes);
    return content.kind == PartialContent::Kind::Part
               ? std::to_string(content.first) + "+" + std::to_string(content.bytes)
           : content.kind == PartialContent::Kind::Nothing ? "nothing"
                                                           : "whole";
  };
  EXPECT_EQ(part("bytes=0-0", 10), "0+1");
  EXPECT_EQ(part("bytes=2-5", 10), "2+4");
  EXPECT_EQ(part("bytes=2-", 10), "2+8");
  EXPECT_EQ(part("bytes=2-99", 10), "2+8");
  EXPECT_EQ(part("bytes=-3", 10), "7+3");
  EXPECT_EQ(part("bytes=-99", 10), "0+10");
  EXPECT_EQ(part("bytes=9-18446744073709551615", 10), "9+1");
  for (const char* none : {"bytes=10-", "bytes=10-11", "bytes=-0"}) EXPECT_EQ(part(none, 10), "nothing") << none;
  EXPECT_EQ(part("bytes=0-", 0), "nothing");
  for (const char* other : {"", "bytes", "bytes=", "bytes=-", "bytes=5-2", "bytes=0-1,3-4", "items=0-1", "bytes=a-b",
                            "bytes=0--1", "bytes= 0-1", "bytes=99999999999999999999-"}) {
    EXPECT_EQ(part(other, 10), "whole") << other;
  }
}

/// As a packet log has them, one behind the other.
std::vector<stream::ParsedPacket> packets_in(const std::string& log) {
  std::vector<stream::ParsedPacket> packets;
  std::span<const std::uint8_t> rest(reinterpret_cast<const std::uint8_t*>(log.data()), log.size());
  const auto take = [&rest](std::size_t bytes) {
    const auto taken = rest.first(bytes);
    rest = rest.subspan(bytes);
    return taken;
  };
  while (!rest.empty()) {
    std::array<std::uint32_t, 2> sizes{};
    std::memcpy(sizes.data(), take(8).data(), 8);
    const auto packet = take(sizes[0]);
    packets.push_back(stream::ParsedPacket::parse(packet, take(sizes[1])));
  }
  return packets;
}

class Pages : public GatewayTest {
 protected:
  /// 2500 Gaussians in frozen pages behind a streamer that nobody views.
  void SetUp() override {
    trainer_.freeze(true);
    trainer_.publish(stream::test::toy_model(kCount, 1));
    start_streamer();
  }
  [[nodiscard]] nlohmann::json manifest() const {
    return nlohmann::json::parse(get(port_, "/manifest.json").body, nullptr, false);
  }
  /// Once it names all of them.
  [[nodiscard]] std::vector<std::string> paths() const {
    std::vector<std::string> paths;
    EXPECT_TRUE(bus_test::eventually([&] {
      const nlohmann::json named = manifest();
      if (!named.is_object() || named["gaussians"] != kCount) return false;
      paths.clear();
      for (const auto& page : named["pages"]) paths.push_back(page["path"]);
      return true;
    }));
    return paths;
  }
  static constexpr std::size_t kCount = 2500;
};

TEST_F(Pages, MakeTheReplicaThatAViewerHas) {
  start_gateway(endpoint());
  const std::vector<std::string> all = paths();
  EXPECT_GE(all.size(), 3U);
  stream::Replica cached;
  for (const auto& packet : packets_in(get(port_, "/manifest").body)) cached.receive(packet);
  for (const std::string& path : all) {
    const HttpAnswer page = get(port_, path);
    ASSERT_EQ(page.status, 200) << path;
    for (const auto& packet : packets_in(page.body)) cached.receive(packet);
  }
  EXPECT_EQ(cached.count(), kCount);
  EXPECT_EQ(cached.missing_pages(), 0U);
  EXPECT_EQ(status()["gateway"]["pages_fetched"], all.size());
  viewer::StreamClient client(client_options("viewer"));
  ASSERT_TRUE(poll_until([&] { return client.replica().count() == kCount; }, client));
  ASSERT_EQ(client.replica().held_pages(), cached.held_pages());
  const auto visibility = static_cast<std::size_t>(cached.held().layout.find(stream::Attribute::Visibility)->first);
  for (const auto& [number, page] : cached.held().pages) {
    auto mine = cached.held().lanes(page),
         theirs = client.replica().held().lanes(*client.replica().held().find(number));
    // That is beside the pages.
    mine.channels.erase(mine.channels.begin() + static_cast<std::ptrdiff_t>(visibility));
    theirs.channels.erase(theirs.channels.begin() + static_cast<std::ptrdiff_t>(visibility));
    EXPECT_EQ(mine.channels, theirs.channels) << number;
    EXPECT_EQ(mine.object_id, theirs.object_id) << number;
  }
}

TEST_F(Pages, AreCachedForGood) {
  start_gateway(endpoint());
  const std::string path = paths().front();
  const HttpAnswer first = get(port_, path);
  const std::string etag = first.field("ETag");
  EXPECT_EQ(first.field("Cache-Control"), "public, max-age=31536000, immutable");
  EXPECT_EQ(first.field("Content-Type"), "application/octet-stream");
  EXPECT_THAT(etag, AllOf(testing::StartsWith("\""), Not(HasSubstr("W/"))));
  const HttpAnswer same = get(port_, path, "If-None-Match: " + etag + "\r\n");
  EXPECT_EQ(same.status, 304);
  EXPECT_EQ(same.field("ETag"), etag);
  EXPECT_EQ(same.body, "");
  EXPECT_EQ(get(port_, path, "If-None-Match: \"other\"\r\n").status, 200);
  const HttpAnswer head = ask(port_, "HEAD " + path + " HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n");
  EXPECT_EQ(head.field("Content-Length"), std::to_string(first.body.size()));
  EXPECT_EQ(head.body, "");
  const HttpAnswer part = get(port_, path, "Range: bytes=8-107\r\n");
  EXPECT_EQ(part.status, 206);
  EXPECT_EQ(part.body, first.body.substr(8, 100));
  EXPECT_EQ(part.field("Content-Range"), "bytes 8-107/" + std::to_string(first.body.size()));
  EXPECT_EQ(get(port_, path, "Range: bytes=8-107\r\nIf-Range: \"other\"\r\n").status, 200);
  const HttpAnswer beyond = get(port_, path, "Range: bytes=99999999-\r\n");
  EXPECT_EQ(beyond.status, 416);
  EXPECT_EQ(beyond.field("Content-Range"), "bytes */" + std::to_string(first.body.size()));
  EXPECT_EQ(status()["gateway"]["pages_fetched"], 1) << "the streamer was asked once";
  // Of a page that has been encoded it says the very bytes.
  const auto page_packet = packets_in(first.body).front();
  ASSERT_TRUE(bus_test::eventually([&] {
    const nlohmann::json named = this->manifest();
    for (const auto& page : named["pages"]) {
      if (page["path"] == path) return page["bytes"] == page_packet.root().body_as_Page()->blob_bytes();
    }
    return false;
  }));
  const HttpAnswer manifest = get(port_, "/manifest");
  EXPECT_EQ(manifest.field("Cache-Control"), "public, max-age=1, must-revalidate");
  EXPECT_EQ(get(port_, "/manifest", "If-None-Match: " + manifest.field("ETag") + "\r\n").status, 304);
  // Another gateway gives the same bytes the same name.
  start_gateway(endpoint());
  const HttpAnswer again = get(port_, path);
  EXPECT_EQ(again.field("ETag"), etag);
  EXPECT_TRUE(again.body == first.body);
  EXPECT_TRUE(get(port_, "/manifest").body == manifest.body);
}

TEST_F(Pages, ThatTheManifestDoesNotNameAreNotThere) {
  start_gateway(endpoint());
  const std::string path = paths().front();
  const auto name = gateway::parse_page_path(path).value();
  for (const PageName& wrong : {PageName{name.epoch, name.page, name.version + 1000}, PageName{name.epoch, 9999, 1},
                                PageName{name.epoch + 1, name.page, name.version}}) {
    EXPECT_EQ(get(port_, gateway::path_of(wrong)).status, 404) << gateway::path_of(wrong);
  }
  EXPECT_EQ(get(port_, "/page/0/0/0").status, 404);
  EXPECT_EQ(status()["gateway"]["pages_fetched"], 0);
  trainer_.freeze(false);
  trainer_.publish(stream::test::toy_model(kCount, 2));
  EXPECT_TRUE(bus_test::eventually([&] { return manifest()["pages"].empty(); })) << "pages that are trained on";
  EXPECT_EQ(get(port_, path).status, 404);
}

TEST_F(Pages, AreForThoseWithAToken) {
  // printf %s abc | sha256sum
  const std::string tokens = write("tokens", "view ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad\n");
  std::filesystem::permissions(tokens, std::filesystem::perms::owner_read | std::filesystem::perms::owner_write);
  start_gateway(endpoint(), {{"tokens", tokens}});
  std::string path;
  ASSERT_TRUE(bus_test::eventually([&] {
    const auto named = nlohmann::json::parse(get(port_, "/manifest.json?token=abc").body, nullptr, false);
    if (!named.is_object() || named["pages"].empty()) return false;
    path = named["pages"][0]["path"];
    return true;
  }));
  for (const std::string& target : {std::string("/manifest"), std::string("/manifest.json"), path}) {
    EXPECT_EQ(get(port_, target).status, 401) << target;
    EXPECT_THAT(get(port_, target, "Authorization: Bearer abc\r\n").field("Cache-Control"),
                testing::StartsWith("private, "))
        << target;
  }
  start_gateway(endpoint(), {{"tokens", tokens}, {"shared_caches", "true"}});
  const HttpAnswer shared = get(port_, path, "Authorization: Bearer abc\r\n");
  EXPECT_EQ(shared.field("Cache-Control"), "public, max-age=31536000, immutable");
  EXPECT_EQ(get(port_, path).status, 401) << "from here";
}

TEST_F(Pages, ABrowsersOwnRequestForThemGoesNoFurther) {
  start_with_fake();
  WebSocketClient page(port_);
  page.send_packet(packet(wire::Body::PageRequest, [](auto& b) { return wire::CreatePageRequest(b, true); }).packet);
  const auto posed = pose();
  page.send_packet(posed.packet);
  EXPECT_EQ(fake_->receive().frames, std::vector<std::string>{text_of(posed.packet)}) << "the first that came";
  EXPECT_EQ(refused("forbidden"), 1);
}

/// Without a gateway.
class Library : public Pages {
 protected:
  [[nodiscard]] PageLibrary::Found fetch(PageLibrary& library, const PageName& name) const {
    PageLibrary::Found found;
    EXPECT_TRUE(bus_test::eventually([&] {
      (void)library.poll(bus::now_ns());
      found = library.page(name, bus::now_ns());
      return found.state != PageLibrary::State::Waits;
    }));
    return found;
  }
  zmq::context_t context_;
  gateway::Traffic traffic_;
};

TEST_F(Library, KeepsThoseThatWereAskedForLast) {
  std::vector<PageName> names;
  std::size_t largest = 0;
  {
    PageLibrary ample(context_, endpoint(), std::size_t{1} << 30, traffic_);
    ASSERT_TRUE(bus_test::eventually([&] {
      (void)ample.poll(bus::now_ns());
      const auto found = ample.manifest(true, bus::now_ns());
      if (found.state != PageLibrary::State::Here) return false;
      names.clear();
      const auto named = nlohmann::json::parse(*found.body);
      for (const auto& page : named["pages"]) {
        names.push_back(gateway::parse_page_path(std::string(page["path"])).value());
      }
      return names.size() >= 3;
    }));
    for (const PageName& name : names) largest = std::max(largest, fetch(ample, name).body->size());
  }
  traffic_ = {};
  PageLibrary library(context_, endpoint(), 2 * largest, traffic_);
  ASSERT_EQ(fetch(library, names[0]).state, PageLibrary::State::Here);
  ASSERT_EQ(fetch(library, names[1]).state, PageLibrary::State::Here);
  ASSERT_EQ(fetch(library, names[0]).state, PageLibrary::State::Here);
  ASSERT_EQ(fetch(library, names[2]).state, PageLibrary::State::Here);
  EXPECT_LE(library.bytes(), 2 * largest);
  EXPECT_EQ(traffic_.page_bytes, library.bytes());
  EXPECT_EQ(traffic_.pages_fetched, 3U);
  ASSERT_EQ(fetch(library, names[0]).state, PageLibrary::State::Here);
  EXPECT_EQ(traffic_.pages_fetched, 3U) << "the other one had to go";
  for (const PageName& name : names) ASSERT_EQ(fetch(library, name).state, PageLibrary::State::Here);
  EXPECT_GT(traffic_.pages_fetched, 3U);
  EXPECT_LE(library.bytes(), 2 * largest);
}

TEST_F(Library, FindsAStreamerThatComesBack) {
  PageLibrary library(context_, endpoint(), std::size_t{1} << 20, traffic_);
  const auto epoch = [&]() -> std::string {
    (void)library.poll(bus::now_ns());
    const auto found = library.manifest(true, bus::now_ns());
    return found.state == PageLibrary::State::Here ? nlohmann::json::parse(*found.body)["stream_epoch"] : "";
  };
  std::string before;
  ASSERT_TRUE(bus_test::eventually([&] { return !(before = epoch()).empty(); }));
  kill_streamer();
  start_streamer();
  EXPECT_TRUE(bus_test::eventually([&] {
    const std::string now = epoch();
    return !now.empty() && now != before;
  }));
}

}  // namespace
}  // namespace splatbus::gateway_test
