// What the gateway answers, and to whom.
#include "../../bus/log_capture.h"
#include "gateway/bench_log.h"
#include "gateway_fixture.h"
#include "wire/system_generated.h"

namespace splatbus::gateway_test {
namespace {

using testing::HasSubstr;
using testing::Not;

// printf %s abc | sha256sum
constexpr const char* kHashOfAbc = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";

class Http : public GatewayTest {
 protected:
  void SetUp() override {
    write("web/index.html", "<!doctype html>the page");
    write("web/app.js", "the script");
    write("web/deep/er/splat.wasm", std::string("\0asm", 4));
    write("web/secret.key", "of no type that a page has");
    write("outside.txt", "outside of the page");
    std::filesystem::create_symlink(directory_.path() + "/outside.txt", directory_.path() + "/web/link.txt");
  }
  void start(Settings settings = {}) {
    settings.emplace_back("web_root", directory_.path() + "/web");
    start_with_fake(settings);
  }
  /// As a person's tools would say it, but for the first line.
  [[nodiscard]] HttpAnswer send(const std::string& request_line, const std::string& fields = "",
                                const std::string& body = "") const {
    return ask(port_, request_line + "\r\nHost: localhost\r\n" + fields + "Connection: close\r\n\r\n" + body);
  }
};

TEST_F(Http, ServesThePageWithItsFields) {
  start();
  const HttpAnswer page = get(port_, "/");
  EXPECT_EQ(page.status, 200);
  EXPECT_EQ(page.body, "<!doctype html>the page");
  EXPECT_EQ(page.field("Content-Type"), "text/html; charset=utf-8");
  EXPECT_EQ(page.field("Cross-Origin-Opener-Policy"), "same-origin");
  EXPECT_EQ(page.field("Cross-Origin-Embedder-Policy"), "require-corp");
  EXPECT_EQ(page.field("X-Content-Type-Options"), "nosniff");
  EXPECT_THAT(page.field("Content-Security-Policy"),
              testing::AllOf(HasSubstr("default-src 'self';"), HasSubstr("script-src 'self' 'wasm-unsafe-eval';")));
  EXPECT_EQ(get(port_, "/app.js?v=1").field("Content-Type"), "text/javascript; charset=utf-8");
  const HttpAnswer wasm = get(port_, "/deep/er/splat.wasm");
  EXPECT_EQ(wasm.field("Content-Type"), "application/wasm");
  EXPECT_EQ(wasm.body, std::string("\0asm", 4));
  const HttpAnswer head = send("HEAD /app.js HTTP/1.1");
  EXPECT_EQ(head.field("Content-Length"), "10");
  EXPECT_EQ(head.body, "");
}

TEST_F(Http, WhatABrowserHasIsNotSentAgain) {
  start();
  const HttpAnswer first = get(port_, "/app.js");
  const std::string etag = first.field("ETag");
  EXPECT_EQ(etag.size(), 34U);
  EXPECT_EQ(first.field("Cache-Control"), "no-cache") << "it is asked for again each time, and mostly not sent";
  const HttpAnswer again = get(port_, "/app.js", "If-None-Match: \"other\", W/" + etag + "\r\n");
  EXPECT_EQ(again.status, 304);
  EXPECT_EQ(again.body, "");
  EXPECT_EQ(get(port_, "/app.js", "If-None-Match: \"other\"\r\n").status, 200);
  EXPECT_NE(get(port_, "/").field("ETag"), etag);
}

TEST_F(Http, APageThatDrawsWithoutTheFilterSaysSoInItsAddress) {
  start({{"mip", "false"}});
  const HttpAnswer bare = get(port_, "/");
  EXPECT_EQ(bare.status, 302);
  EXPECT_EQ(bare.field("Location"), "/?mip=0");
  EXPECT_EQ(bare.field("Cache-Control"), "no-store");
  EXPECT_EQ(get(port_, "/?").field("Location"), "/?mip=0");
  EXPECT_EQ(get(port_, "/?gpu=webgl2&token=a").field("Location"), "/?gpu=webgl2&token=a&mip=0");
  EXPECT_EQ(get(port_, "/?mip=0").status, 200);
  EXPECT_EQ(get(port_, "/?gpu=webgl2&mip=1").status, 200) << "who asks for it may see it otherwise";
  EXPECT_EQ(get(port_, "/index.html").status, 200);
}

TEST_F(Http, NothingButThePageIsServed) {
  start();
  write("web/late.txt", "came after the start");
  for (const char* target :
       {"/../outside.txt", "/deep/../../outside.txt", "/%2e%2e/outside.txt", "/..%2foutside.txt", "/..\\outside.txt",
        "//etc/passwd", "/./app.js", "/deep/", "/deep", "/link.txt", "/secret.key", "/late.txt", "/app.js/", "/%00",
        "/app.js%00.html", "/index.html/../../outside.txt"}) {
    const HttpAnswer answer = get(port_, target);
    EXPECT_EQ(answer.status, 404) << target;
    EXPECT_THAT(answer.body, Not(HasSubstr("outside of"))) << target;
  }
}

TEST_F(Http, OnlyWhatIsMeantIsUnderstood) {
  start();
  EXPECT_EQ(send("DELETE /app.js HTTP/1.1").status, 405);
  EXPECT_EQ(send("POST /app.js HTTP/1.1", "Content-Length: 1\r\n", "x").status, 405);
  EXPECT_EQ(send("GET /bench HTTP/1.1").field("Allow"), "POST");
  EXPECT_EQ(send("GET /stream HTTP/1.1").status, 426);
  EXPECT_EQ(send("GET http://localhost/ HTTP/1.1").status, 400);
  EXPECT_EQ(send("CONNECT localhost:22 HTTP/1.1").status, 400);
  EXPECT_EQ(send("GET /" + std::string(3000, 'a') + " HTTP/1.1").status, 400);
  EXPECT_EQ(send("GET / HTTP/1.1", "Filler: " + std::string(9000, 'a') + "\r\n").status, 431);
  EXPECT_EQ(send("POST /bench HTTP/1.1", "Content-Type: application/json\r\nContent-Length: 99999999\r\n", "{").status,
            413);
  EXPECT_EQ(ask(port_, "GET / HTTP/1.1\r\n\r\n").status, 400) << "no Host";
  EXPECT_EQ(ask(port_, "GET / HTTP/1.1\r\nHost: localhost\r\nHost: other\r\n\r\n").status, 400);
}

TEST_F(Http, ARequestHiddenInAnotherIsNoRequest) {
  start();
  const std::string hidden = "GET /status HTTP/1.1\r\nHost: localhost\r\n\r\n";
  const std::string length = std::to_string(hidden.size());
  for (const std::string& fields : {
           "Transfer-Encoding: chunked\r\nContent-Length: " + length + "\r\n",
           "Content-Length: " + length + "\r\nTransfer-Encoding: chunked\r\n",
           "Content-Length: 0\r\nContent-Length: " + length + "\r\n",
           "Content-Length: " + length + "\r\nContent-Length: " + length + "\r\n",
           std::string("Content-Length: -1\r\n"),
           "Content-Length: +" + length + "\r\n",
           "Content-Length: " + length + "\r\n",
           std::string("Transfer-Encoding: identity\r\n"),
           std::string("Transfer-Encoding: xchunked\r\n"),
           std::string("Transfer-Encoding : chunked\r\n"),
           "Content-Length: 0\r\n Content-Length: " + length + "\r\n",
           std::string("X: a\nTransfer-Encoding: chunked\r\n"),
       }) {
    WireClient client(port_);
    client.send("GET / HTTP/1.1\r\nHost: localhost\r\n" + fields + "\r\n" + hidden);
    const std::string all = client.receive_rest();
    EXPECT_EQ(parse_answer(all).status, 400) << fields;
    EXPECT_EQ(all.find("HTTP/1.1", 1), std::string::npos) << "a second answer: " << fields;
  }
}

TEST_F(Http, RequestsFollowOneAnother) {
  start();
  WireClient client(port_);
  client.send(
      "GET /app.js HTTP/1.1\r\nHost: localhost\r\n\r\nGET / HTTP/1.1\r\nHost: localhost\r\n"
      "Connection: close\r\n\r\n");
  const std::string all = client.receive_rest();
  EXPECT_THAT(all, HasSubstr("the script"));
  EXPECT_THAT(all, HasSubstr("the page"));
}

TEST_F(Http, GarbageEndsItsOwnConnectionAlone) {
  start();
  WebSocketClient good(port_);
  good.send_packet(hello().packet);
  const std::string peer = fake_->receive().peer;
  std::mt19937 random(7);
  for (int i = 0; i < 50; ++i) {
    std::string bytes(1 + random() % 3000, '\0');
    for (char& byte : bytes) byte = static_cast<char>(random());
    WireClient client(port_);
    client.send(i % 2 == 0 ? bytes : "GET / HTTP/1.1\r\nHost: localhost\r\n" + bytes);
    client.end_sending();
    EXPECT_TRUE(client.ends()) << i;
    ASSERT_TRUE(fake_->send(peer, {"p", "still"}));
    EXPECT_EQ(page_text(good), "pstill");
  }
}

TEST_F(Http, AForeignPageLearnsNothing) {
  start({{"origins", "https://friend.example"}});
  EXPECT_EQ(get(port_, "/status", "Origin: http://evil.example\r\n").status, 403);
  EXPECT_EQ(get(port_, "/status", "Origin: null\r\n").status, 403);
  EXPECT_EQ(get(port_, "/status", "Origin: https://friend.example\r\n").status, 200);
  EXPECT_EQ(get(port_, "/status", "Origin: http://localhost:" + std::to_string(port_) + "\r\n").status, 200);
  EXPECT_EQ(ask(port_, "GET /status HTTP/1.1\r\nHost: rebound.example\r\nConnection: close\r\n\r\n").status, 421);
  EXPECT_EQ(refused("origin"), 2);
  EXPECT_EQ(refused("host"), 1);
}

TEST_F(Http, HealthIsThatOfBusAndStreamer) {
  start();
  ASSERT_TRUE(bus_test::eventually([&] { return get(port_, "/healthz").body == "no streamer is alive\n"; }));
  EXPECT_EQ(get(port_, "/healthz").status, 503);
  const bus::Publisher streamer(connect("streamer"));
  ASSERT_TRUE(bus_test::eventually([&] {
    streamer.publish(topics::kHeartbeat, {.latch_key = "streamer"}, [](auto& builder, auto header) {
      return wire::CreateHeartbeatDirect(builder, header, "streamer", 1, wire::ServiceState::Running);
    });
    return get(port_, "/healthz").status == 200;
  }));
  broker_.reset();
  EXPECT_TRUE(bus_test::eventually([&] { return get(port_, "/healthz").body == "the bus is silent\n"; }));
}

TEST_F(Http, WhatPagesMeasureIsShown) {
  start();
  const auto post = [&](const std::string& body, const std::string& type = "application/json") {
    return send("POST /bench HTTP/1.1",
                "Content-Type: " + type + "\r\nContent-Length: " + std::to_string(body.size()) + "\r\n", body)
        .status;
  };
  EXPECT_EQ(post(R"({"fps": 61.5, "gpu": "some"})"), 204);
  EXPECT_EQ(status()["bench"], nlohmann::json::parse(R"([{"fps": 61.5, "gpu": "some"}])"));
  EXPECT_EQ(post(R"({"fps": 1})", "text/plain"), 415) << "any page may send that";
  EXPECT_THAT(post("[]"), testing::AnyOf(400, 429));
  EXPECT_EQ(status()["bench"].size(), 1U);
}

TEST(BenchLog, IsBounded) {
  gateway::BenchLog log;
  for (int i = 0; i < 40; ++i) EXPECT_EQ(log.add("{\"run\": " + std::to_string(i) + "}"), "");
  ASSERT_EQ(log.reports().size(), 16U);
  EXPECT_EQ(log.reports().front()["run"], 24);
  for (const std::string& wrong : {std::string("nonsense"), std::string("[1]"), std::string("\"text\""), std::string(),
                                   "{\"a\": " + std::string(8000, '[') + std::string(8000, ']') + "}",
                                   "{\"a\": \"" + std::string(20000, 'x') + "\"}", std::string("{\"a\": \"\xff\"}")}) {
    EXPECT_NE(log.add(wrong), "") << wrong.substr(0, 20);
  }
  EXPECT_EQ(log.reports().back()["run"], 39);
}

TEST(BenchLog, WritesOneLineASecond) {
  gateway::BenchLog bench;
  const bus_test::LogCapture log;
  for (int i = 0; i < 200; ++i) EXPECT_EQ(bench.add("{\"run\": 1}"), "");
  EXPECT_GT(log.lines(), 0);
  EXPECT_LT(log.lines(), 50) << "anybody who may measure has us say it";
}

TEST_F(Http, WithTokensFiguresAndStreamAskForOne) {
  const std::string tokens = write("tokens", std::string("view ") + kHashOfAbc + "\n");
  std::filesystem::permissions(tokens, std::filesystem::perms::owner_read | std::filesystem::perms::owner_write);
  start({{"tokens", tokens}});
  EXPECT_EQ(get(port_, "/").status, 200) << "the page is no secret";
  EXPECT_EQ(get(port_, "/healthz").status, 503);
  for (const char* target : {"/status", "/metrics", "/status?token=", "/status?token=abd", "/metrics?x=1&token=ab"}) {
    EXPECT_EQ(get(port_, target).status, 401) << target;
  }
  EXPECT_EQ(get(port_, "/status?token=abc").status, 200);
  EXPECT_EQ(get(port_, "/metrics", "Authorization: Bearer abc\r\n").status, 200);
  EXPECT_EQ(get(port_, "/metrics", "Authorization: Bearer abcd\r\n").status, 401);
  const auto connect_with = [&](const std::string& protocols, const std::string& target = "/stream") {
    const WebSocketClient page(port_, {.fields = "Sec-WebSocket-Protocol: " + protocols + "\r\n", .target = target});
    return page.answer().status;
  };
  EXPECT_EQ(connect_with("splatbus.stream.1"), 401);
  EXPECT_EQ(connect_with("splatbus.stream.1, splatbus.token.abd"), 401);
  EXPECT_EQ(connect_with("splatbus.stream.1, splatbus.token.abc"), 101);
  EXPECT_EQ(connect_with("splatbus.token.abc,splatbus.stream.1"), 101);
  EXPECT_EQ(connect_with("splatbus.stream.1", "/stream?token=abc"), 101);
  EXPECT_EQ(connect_with("splatbus.token.abc"), 400);
}

TEST_F(Http, ATokenThatIsTakenAwayEndsItsConnection) {
  const std::string tokens = write("tokens", std::string("view ") + kHashOfAbc + "\n");
  std::filesystem::permissions(tokens, std::filesystem::perms::owner_read | std::filesystem::perms::owner_write);
  start({{"tokens", tokens}});
  WebSocketClient page(port_, {.target = "/stream?token=abc"});
  ASSERT_TRUE(page.open());
  write("tokens", "# nobody any more\n");
  EXPECT_FALSE(page.receive());
  EXPECT_EQ(page.close_code(), 1008) << "it is told";
  EXPECT_TRUE(page.wire().ends());
}

}  // namespace
}  // namespace splatbus::gateway_test
