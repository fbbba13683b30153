// With a certificate: TLS and nothing else.
#include <cstdlib>

#include "bus/error.h"
#include "gateway_fixture.h"

namespace splatbus::gateway_test {
namespace {

class WithTls : public GatewayTest {
 protected:
  void SetUp() override {
    const std::string command =
        "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2 "
        "-subj /CN=localhost -keyout " +
        key() + " -out " + certificate() + " 2>/dev/null";
    ASSERT_EQ(std::system(command.c_str()), 0) << command;
  }
  [[nodiscard]] std::string key() const { return directory_.path() + "/key.pem"; }
  [[nodiscard]] std::string certificate() const { return directory_.path() + "/certificate.pem"; }
  static constexpr WireClient::Options kTls{.tls = true};
};

TEST_F(WithTls, BrowsersAndFiguresAreServed) {
  FakeStreamer& streamer = start_with_fake({{"certificate", certificate()}, {"key", key()}});
  EXPECT_THAT(gateway_->url(), testing::StartsWith("https://localhost:"));
  EXPECT_EQ(get(port_, "/metrics", "", kTls).status, 200);
  WebSocketClient page(port_, {.wire = kTls});
  ASSERT_TRUE(page.open());
  const auto greeting = hello();
  page.send_packet(greeting.packet);
  const auto received = streamer.receive();
  EXPECT_THAT(received.frames, testing::ElementsAre(text_of(greeting.packet)));
  const std::string payload(200000, 'x');
  ASSERT_TRUE(streamer.send(received.peer, {"p", payload}));
  EXPECT_EQ(page_text(page).size(), payload.size() + 1);
}

TEST_F(WithTls, PlaintextIsNotAnswered) {
  start_with_fake({{"certificate", certificate()}, {"key", key()}, {"handshake_s", "0.5"}});
  EXPECT_EQ(get(port_, "/healthz").status, 0);
  WireClient silent(port_);
  EXPECT_TRUE(silent.ends()) << "a handshake that never begins";
  EXPECT_EQ(get(port_, "/metrics", "", kTls).status, 200);
}

TEST_F(WithTls, WithoutACertificateThereIsNone) {
  start_with_fake();
  EXPECT_THROW(WireClient(port_, kTls), std::runtime_error);
}

TEST_F(WithTls, AWrongKeyIsNamed) {
  const std::string wrong = write("wrong.pem", "nothing of the kind");
  const auto problem = [&](const std::string& c, const std::string& k) -> std::string {
    try {
      start_with_fake({{"certificate", c}, {"key", k}});
    } catch (const bus::Error& error) {
      return error.what();
    }
    return {};
  };
  EXPECT_THAT(problem(certificate(), wrong), testing::HasSubstr("key " + wrong));
  EXPECT_THAT(problem(wrong, key()), testing::HasSubstr("certificate " + wrong));
  EXPECT_THAT(problem("/nonexistent", key()), testing::HasSubstr("certificate /nonexistent"));
}

TEST(Addresses, APortThatIsTakenIsNamed) {
  bus_test::TemporaryDirectory folder;
  const auto context = bus::Context::create(folder.address(), "gateway");
  const RunningGateway first(context, "ipc://" + folder.path() + "/s", {});
  const std::string taken = "127.0.0.1:" + std::to_string(first.port());
  try {
    const RunningGateway second(context, "ipc://" + folder.path() + "/s", {{"http", taken}});
    FAIL() << "it was bound twice";
  } catch (const bus::Error& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("http " + taken + ": Address already in use"));
  }
}

}  // namespace
}  // namespace splatbus::gateway_test
