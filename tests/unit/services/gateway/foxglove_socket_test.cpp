// Clients of Foxglove's protocol at the gateway's own socket: who comes in, and what those can do who mean harm.
#include "gateway_fixture.h"
#include "wire/system_generated.h"

namespace splatbus::gateway_test {
namespace {

using Frame = WebSocketClient;

class FoxgloveSocket : public GatewayTest {
 protected:
  static WebSocketClient::Options asking_for(const std::string& protocols, const std::string& target = "/foxglove",
                                             const std::string& more = "") {
    WebSocketClient::Options options;
    options.target = target;
    options.fields = "Sec-WebSocket-Protocol: " + protocols + "\r\n" + more;
    return options;
  }
  [[nodiscard]] nlohmann::json foxglove() const { return status()["gateway"]["foxglove"]; }
};

TEST_F(FoxgloveSocket, BothSubprotocolsAreSpokenOnTwoPaths) {
  start_with_fake();
  for (const char* path : {"/", "/foxglove"}) {
    for (const char* name : {"foxglove.sdk.v1", "foxglove.websocket.v1"}) {
      const WebSocketClient client(port_, asking_for(name, path));
      EXPECT_TRUE(client.open());
      EXPECT_EQ(client.answer().field("Sec-WebSocket-Protocol"), name);
    }
  }
  const WebSocketClient both(port_, asking_for("foxglove.websocket.v1, foxglove.sdk.v1"));
  EXPECT_EQ(both.answer().field("Sec-WebSocket-Protocol"), "foxglove.sdk.v1");
  EXPECT_EQ(WebSocketClient(port_, asking_for("foxglove.sdk.v9")).answer().status, 400);
  EXPECT_EQ(WebSocketClient(port_, asking_for("splatbus.stream.1")).answer().status, 400);
  EXPECT_EQ(WebSocketClient(port_, asking_for("foxglove.sdk.v1", "/stream")).answer().status, 400);
  EXPECT_EQ(WebSocketClient(port_, asking_for("foxglove.sdk.v1", "/status")).answer().status, 404);
  EXPECT_EQ(get(port_, "/foxglove").status, 426);
}

TEST_F(FoxgloveSocket, StrangersAreTurnedAway) {
  const std::string hash = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";  // SHA-256("abc")
  const std::string tokens = write("tokens", "view " + hash + "\n");
  std::filesystem::permissions(tokens, std::filesystem::perms::owner_read | std::filesystem::perms::owner_write);
  start_with_fake({{"tokens", tokens}});
  EXPECT_EQ(WebSocketClient(port_, asking_for("foxglove.sdk.v1")).answer().status, 401);
  EXPECT_EQ(WebSocketClient(port_, asking_for("foxglove.sdk.v1", "/foxglove?token=abd")).answer().status, 401);
  EXPECT_EQ(WebSocketClient(port_, asking_for("foxglove.sdk.v1", "/foxglove", "Origin: https://elsewhere.org\r\n"))
                .answer()
                .status,
            403);
  WebSocketClient allowed(port_, asking_for("foxglove.sdk.v1", "/?token=abc"));
  ASSERT_TRUE(allowed.open());
  allowed.send_frame(Frame::kText, R"({"op": "setParameters", "parameters": [{"name": "trainer/x", "value": 1}]})");
  EXPECT_TRUE(bus_test::eventually([&] {
    const auto answer = status("Authorization: Bearer abc\r\n");
    return answer["gateway"]["refused"]["forbidden"] == 1;
  })) << "it may look only";
  std::ofstream(tokens) << "# nobody\n";
  while (allowed.receive()) {  // the time
  }
  EXPECT_EQ(allowed.close_code(), 1008) << "its token is gone";
}

TEST_F(FoxgloveSocket, ClientsAreBounded) {
  start_with_fake({{"max_foxglove_clients", "2"}});
  const WebSocketClient first(port_, asking_for("foxglove.sdk.v1"));
  {
    const WebSocketClient second(port_, asking_for("foxglove.sdk.v1"));
    ASSERT_TRUE(second.open());
    EXPECT_TRUE(bus_test::eventually([&] { return foxglove()["clients"] == 2; }));
    EXPECT_EQ(WebSocketClient(port_, asking_for("foxglove.sdk.v1")).answer().status, 503);
  }
  EXPECT_TRUE(bus_test::eventually([&] { return WebSocketClient(port_, asking_for("foxglove.sdk.v1")).open(); }));
}

TEST_F(FoxgloveSocket, WhatIsNotUnderstoodEndsItsConnection) {
  start_with_fake();
  WebSocketClient good(port_, asking_for("foxglove.sdk.v1"));
  struct Case {
    std::uint8_t opcode;
    std::string payload;
    int code;
  };
  for (const Case& bad :
       {Case{Frame::kText, "hello", 1008}, Case{Frame::kText, "{}", 1008}, Case{Frame::kText, "\xff\xfe", 1007},
        Case{Frame::kText, R"({"op": "subscribe", "subscriptions": "all"})", 1008}, Case{Frame::kBinary, "", 1008},
        Case{Frame::kBinary, "\x09", 1008}, Case{Frame::kText, std::string(60000, '['), 1008},
        Case{Frame::kText, std::string(70000, ' '), 1009}, Case{3, "reserved", 1002}}) {
    WebSocketClient client(port_, asking_for("foxglove.sdk.v1"));
    ASSERT_TRUE(client.open());
    client.send_frame(bad.opcode, bad.payload);
    while (client.receive()) {  // the time
    }
    EXPECT_EQ(client.close_code(), bad.code) << bad.payload.substr(0, 20);
    EXPECT_TRUE(client.wire().ends());
  }
  EXPECT_TRUE(good.receive()) << "is told the time";
  EXPECT_TRUE(bus_test::eventually([&] { return foxglove()["clients"] == 1; }));
}

TEST_F(FoxgloveSocket, OneThatStopsReadingCostsABoundedQueue) {
  start_with_fake({{"foxglove_queue_mb", "1"}, {"stall_s", "3600"}, {"idle_s", "3600"}});
  WebSocketClient::Options slow = asking_for("foxglove.sdk.v1");
  slow.wire.receive_buffer = 4096;
  WebSocketClient stopped(port_, slow);
  WebSocketClient good(port_, asking_for("foxglove.sdk.v1"));
  // Fixed channels have the first ids; the log's is one of them, and the others cost nothing.
  const std::string all =
      R"({"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 1}, {"id": 2, "channelId": 2}, {"id": 3, "channelId": 3}]})";
  stopped.send_frame(Frame::kText, all);
  good.send_frame(Frame::kText, all);
  const bus::Publisher publisher(connect("service"));
  const std::string text(4000, 'x');
  std::size_t got = 0;
  EXPECT_TRUE(bus_test::eventually([&] {
    for (int i = 0; i < 500; ++i) {
      publisher.publish(topics::kLog, [&](auto& builder, auto header) {
        return wire::CreateLogDirect(builder, header, wire::LogLevel::Info, text.c_str());
      });
    }
    while (const auto message = good.receive(20ms)) got += message->size() > text.size() ? 1 : 0;
    const auto figures = foxglove();
    EXPECT_LE(figures["queued_bytes"], 3U << 20);
    return figures["dropped"] > 100 && got > 1000;
  }));
  EXPECT_TRUE(bus_test::eventually([&] { return foxglove()["clients"] == 2; })) << "it may come to itself";
}

}  // namespace
}  // namespace splatbus::gateway_test
