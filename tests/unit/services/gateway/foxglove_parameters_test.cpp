// Parameters in Foxglove, of services that come and go on a bus.
#include <gmock/gmock.h>

#include <algorithm>
#include <optional>

#include "bus/heartbeat_thread.h"
#include "gateway_fixture.h"

namespace splatbus::gateway_test {
namespace {

using nlohmann::json;

struct ServiceOptions {
  double rate = 4;
  std::string name = "5";
  void bind(bus::ParameterBinder& p) {
    p.add("rate", rate, "a number");
    p.add("name", name, "a text");
  }
};

/// A service as far as its heartbeats go.
class Beating {
 public:
  explicit Beating(const std::shared_ptr<bus::Context>& context)
      : parameters_(bus::Parameters::declare<ServiceOptions>()),
        service_(context, parameters_, {}),
        heartbeats_(service_, "kind-of-" + context->source()) {}
  void end() { heartbeats_.finish(wire::ServiceState::Stopping, ""); }

 private:
  bus::Parameters parameters_;
  bus::ServiceContext service_;
  bus::HeartbeatThread heartbeats_;
};

class FoxgloveParameters : public GatewayTest {
 protected:
  FoxgloveParameters() : service_(connect("gateway"), options_) {}

  /// Until the broker lists that source.
  void wait_for(const std::string& source) {
    gateway::PipelineView view(connect("looker"));
    ASSERT_TRUE(bus_test::eventually([&] {
      view.poll(bus::now_ns());
      const auto services = view.services(bus::now_ns());
      return std::ranges::any_of(services, [&](const auto& one) { return one.source == source && one.alive; });
    }));
  }
  void say(gateway::foxglove::Hub::ClientId client, const json& message) {
    const std::string text = message.dump();
    std::optional<gateway::foxglove::Hub::AssetRequest> asset;
    service_.hub().receive(client, {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()}, false,
                           bus::Rights{.view = true, .control = true}, bus::now_ns(), asset);
  }
  /// The next parameterValues.
  json next(gateway::foxglove::Hub::ClientId client) {
    json found;
    EXPECT_TRUE(bus_test::eventually([&] {
      while (const auto message = service_.hub().take(client)) {
        if (message->binary) continue;
        found = json::parse(message->head);
        if (found["op"] == "parameterValues") return true;
      }
      return false;
    }));
    return found;
  }
  static json ask_all() { return {{"op", "getParameters"}, {"parameterNames", json::array()}, {"id", "all"}}; }
  static json all_of(const std::string& source) {
    return {{{"name", source + "/name"}, {"value", "5"}},
            {{"name", source + "/rate"}, {"value", 4.0}, {"type", "float64"}}};
  }

  gateway::Options options_;
  gateway::foxglove::Service service_;
};

TEST_F(FoxgloveParameters, AreThereForWhoAsksOnceAndAtOnce) {
  Beating trainer(connect("trainer"));
  const Beating successor(connect("trainer.next"));
  wait_for("trainer");
  wait_for("trainer.next");
  for (int visit = 0; visit < 2; ++visit) {  // the second time nothing is left of the first
    const auto client = service_.hub().join([] {});
    say(client, ask_all());
    const json answer = next(client);
    EXPECT_EQ(answer["id"], "all");
    EXPECT_EQ(answer["parameters"], all_of("trainer")) << "and none of who only stands by";
    service_.hub().leave(client);
  }
}

TEST_F(FoxgloveParameters, GoWithTheirService) {
  const Beating trainer(connect("trainer"));
  Beating replica(connect("streamer-2"));
  wait_for("trainer");
  wait_for("streamer-2");
  const auto client = service_.hub().join([] {});
  say(client, ask_all());
  EXPECT_EQ(next(client)["parameters"].size(), 4U);
  say(client, {{"op", "subscribeParameterUpdates"}, {"parameterNames", json::array()}});
  replica.end();
  EXPECT_EQ(next(client)["parameters"], json::parse(R"([{"name": "streamer-2/name"}, {"name": "streamer-2/rate"}])"));
  say(client, ask_all());
  EXPECT_EQ(next(client)["parameters"], all_of("trainer"));
}

}  // namespace
}  // namespace splatbus::gateway_test
