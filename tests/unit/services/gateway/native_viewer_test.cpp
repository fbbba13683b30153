// Native viewers by the front door.
#include <cstdlib>

#include "bus/error.h"
#include "gateway_fixture.h"
#include "viewer/packet_link.h"

namespace splatbus::gateway_test {
namespace {

using testing::HasSubstr;
using viewer::StreamClient;

class NativeViewer : public GatewayTest {
 protected:
  [[nodiscard]] static viewer::ClientOptions options_for(const std::string& url) {
    return {.endpoint = url, .name = "native", .hello_every_ns = 20'000'000, .pose_every_ns = 0};
  }
  [[nodiscard]] std::string url(const std::string& scheme = "ws", const std::string& host = "127.0.0.1") const {
    return scheme + "://" + host + ":" + std::to_string(port_);
  }
  /// What a link says of why it does not get in.
  static std::string refusal_of(const viewer::WebLinkOptions& options) {
    const auto link = viewer::make_web_link(options);
    std::optional<std::string> notice;
    const auto deadline = std::chrono::steady_clock::now() + bus_test::patience;
    while (!notice && std::chrono::steady_clock::now() < deadline) {
      link->wait(20ms, -1);
      if (link->take_opened()) return "it got in";
      notice = link->take_notice();
    }
    return notice.value_or("nothing");
  }
  void make_certificate(const std::string& name, const std::string& names) const {
    const std::string path = directory_.path() + "/" + name;
    const std::string command =
        "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2 -subj /CN=" + name +
        " -addext subjectAltName=" + names + " -keyout " + path + ".key -out " + path + ".pem 2>/dev/null";
    ASSERT_EQ(std::system(command.c_str()), 0) << command;
  }
};

TEST_F(NativeViewer, HoldsWhatAViewerAtTheStreamerHolds) {
  start_streamer();
  start_gateway(endpoint());
  trainer_.publish(stream::test::toy_model(3000, 1));
  StreamClient native(options_for(url())), direct(client_options("direct"));
  ASSERT_TRUE(
      poll_until([&] { return native.replica().count() == 3000 && direct.replica().count() == 3000; }, native, direct));
  EXPECT_TRUE(
      poll_until([&] { return stream_test::hold_the_same(native.replica(), direct.replica()); }, native, direct));
  EXPECT_EQ(native.refused(), 0U);
  EXPECT_EQ(native.lost(), 0U);
}

TEST_F(NativeViewer, ComesBackToAGatewayThatComesBack) {
  start_streamer();
  start_gateway(endpoint());
  trainer_.publish(stream::test::toy_model(400, 1));
  StreamClient native(options_for(url()));
  ASSERT_TRUE(poll_until([&] { return native.replica().count() == 400; }, native));
  const std::string same_port = "127.0.0.1:" + std::to_string(port_);
  start_gateway(endpoint(), {{"http", same_port}});
  trainer_.publish(stream::test::toy_model(500, 1));
  EXPECT_TRUE(poll_until([&] { return native.replica().count() == 500; }, native));
}

TEST_F(NativeViewer, ATokenLetsItIn) {
  // printf %s abc | sha256sum
  const std::string tokens = write("tokens", "view ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad\n");
  std::filesystem::permissions(tokens, std::filesystem::perms::owner_read | std::filesystem::perms::owner_write);
  start_with_fake({{"tokens", tokens}});
  EXPECT_THAT(refusal_of({.url = url(), .token = {}, .ca = {}}), HasSubstr("refused with 401"));
  EXPECT_THAT(refusal_of({.url = url() + "/#token=abd", .token = {}, .ca = {}}), HasSubstr("refused with 401"));
  EXPECT_EQ(refusal_of({.url = url() + "/#token=abc", .token = {}, .ca = {}}), "it got in");
  EXPECT_EQ(refusal_of({.url = url(), .token = "abc", .ca = {}}), "it got in");
  EXPECT_THROW((void)viewer::make_web_link({.url = url(), .token = "a\r\nb", .ca = {}}), bus::Error);
}

TEST_F(NativeViewer, OnlyACertificateOfThatNameIsTrusted) {
  make_certificate("here", "DNS:localhost,IP:127.0.0.1");
  make_certificate("elsewhere", "DNS:elsewhere.example");
  const std::string here = directory_.path() + "/here", elsewhere = directory_.path() + "/elsewhere";
  FakeStreamer& streamer = start_with_fake({{"certificate", here + ".pem"}, {"key", here + ".key"}});
  EXPECT_THAT(refusal_of({.url = url("wss"), .token = {}, .ca = {}}), HasSubstr("no TLS that can be trusted"));
  EXPECT_THAT(refusal_of({.url = url("wss"), .token = {}, .ca = elsewhere + ".pem"}), HasSubstr("can be trusted"));
  EXPECT_EQ(refusal_of({.url = url("wss"), .token = {}, .ca = here + ".pem"}), "it got in");
  EXPECT_EQ(refusal_of({.url = url("wss", "localhost"), .token = {}, .ca = here + ".pem"}), "it got in");
  viewer::ClientOptions secure = options_for(url("https"));
  secure.ca = here + ".pem";
  {
    StreamClient native(secure);
    const auto deadline = std::chrono::steady_clock::now() + bus_test::patience;
    FakeStreamer::Received greeting;
    while (greeting.frames.empty() && std::chrono::steady_clock::now() < deadline) {
      native.poll(10ms);
      greeting = streamer.receive(0ms);
    }
    EXPECT_FALSE(greeting.frames.empty()) << "its Hello";
  }
  start_gateway(streamer.endpoint(), {{"certificate", elsewhere + ".pem"}, {"key", elsewhere + ".key"}});
  EXPECT_THAT(refusal_of({.url = url("wss"), .token = {}, .ca = elsewhere + ".pem"}), HasSubstr("can be trusted"))
      << "it is trusted, and another's";
  EXPECT_THROW((void)viewer::make_web_link({.url = url("wss"), .token = {}, .ca = "/nonexistent"}), bus::Error);
}

}  // namespace
}  // namespace splatbus::gateway_test
