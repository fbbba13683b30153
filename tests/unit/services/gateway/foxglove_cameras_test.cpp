// Which cameras clients of Foxglove's protocol are shown: those that are asked for.
#include <gmock/gmock.h>

#include <optional>
#include <set>

#include "gateway_fixture.h"
#include "wire/convert.h"
#include "wire/engine_generated.h"

namespace splatbus::gateway_test {
namespace {

using nlohmann::json;
using testing::SizeIs;

class FoxgloveCameras : public GatewayTest {
 protected:
  FoxgloveCameras() : service_(connect("gateway"), options_), client_(service_.hub().join([] {})) {}

  /// Names one set, `engine` "" all of them.
  static void ask(const bus::Publisher& bridge, const std::string& engine, const std::vector<std::uint32_t>& ids,
                  CameraRole role = CameraRole::Reference) {
    const bus::MessageInfo info{.latch_key = engine};
    bridge.publish(topics::kEngineCameras, info, [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
      std::vector<flatbuffers::Offset<wire::CameraRequest>> requests;
      for (const std::uint32_t id : ids) {
        Camera camera = look_at({1, 2, 3}, {0, 0, 0}, 64, 48, 1);
        camera.role = role;
        camera.id = id;
        const wire::Camera out = to_wire(camera);
        requests.push_back(wire::CreateCameraRequest(builder, &out, wire::EngineBuffer::Color, 0, id + 1));
      }
      return wire::CreateEngineCameras(builder, header, builder.CreateVector(requests));
    });
  }
  /// Channels of cameras' pictures, as the client knows them by now.
  const std::set<std::uint32_t>& shown() {
    while (const auto message = service_.hub().take(client_)) {
      if (message->binary) continue;
      const json said = json::parse(message->head);
      if (said["op"] == "advertise") {
        for (const json& channel : said["channels"]) {
          const std::string topic = channel["topic"];
          if (topic.starts_with("foxglove/cameras/") && topic.ends_with("/picture"))
            shown_.insert(channel["id"].get<std::uint32_t>());
        }
      }
      if (said["op"] != "unadvertise") continue;
      for (const json& id : said["channelIds"]) shown_.erase(id.get<std::uint32_t>());
    }
    return shown_;
  }
  /// The topics that it is told of, as it is now.
  std::set<std::string> topics() {
    std::set<std::string> all;
    const auto late = service_.hub().join([] {});
    while (const auto message = service_.hub().take(late)) {
      const json said = message->binary ? json::object() : json::parse(message->head);
      if (said.value("op", "") != "advertise") continue;
      for (const json& channel : said["channels"]) all.insert(channel["topic"].get<std::string>());
    }
    service_.hub().leave(late);
    return all;
  }
  bool show(std::size_t count) {
    return bus_test::eventually([&] { return shown().size() == count; });
  }

  gateway::Options options_;
  gateway::foxglove::Service service_;
  gateway::foxglove::Hub::ClientId client_;
  std::set<std::uint32_t> shown_;
};

TEST_F(FoxgloveCameras, HavePicturesWhereSomebodyPublishesThem) {
  const bus::Publisher bridge(connect("bridge"));
  ask(bridge, "engine-1", {1}, CameraRole::Input);
  ask(bridge, "engine-2", {2});
  EXPECT_TRUE(show(1));
  const auto all = topics();
  for (const char* name :
       {"input-1/calibration", "reference-2/calibration", "reference-2/picture", "reference-2/depth"}) {
    EXPECT_TRUE(all.contains(std::string("foxglove/cameras/") + name)) << name;
  }
  for (const char* name : {"input-1/picture", "input-1/depth"}) {
    EXPECT_FALSE(all.contains(std::string("foxglove/cameras/") + name)) << name;
  }
}

TEST_F(FoxgloveCameras, AreThoseOfTheBridgeThatAsksNowAndOfNoneBefore) {
  const bus::Publisher first(connect("first"));
  std::optional<bus::Publisher> second(connect("second"));
  ask(first, "engine-1", {1, 2});
  ask(first, "engine-2", {3, 4, 5});
  EXPECT_TRUE(show(5));
  // The first is gone, and the second has one engine.
  ask(*second, "", {1});
  EXPECT_TRUE(show(1));
  // Nor are they there again for a client that comes later.
  const auto channel = *shown().begin();
  std::optional<gateway::foxglove::Hub::AssetRequest> asset;
  const std::string wish = json{{"op", "subscribe"}, {"subscriptions", {{{"id", 1}, {"channelId", channel}}}}}.dump();
  service_.hub().receive(client_, {reinterpret_cast<const std::uint8_t*>(wish.data()), wish.size()}, false,
                         bus::Rights{.view = true}, 0, asset);
  EXPECT_FALSE(bus_test::eventually([&] { return shown().size() != 1; }, 300ms));
  // One that is started again under the same name is another one, too.
  ask(*second, "engine-1", {2, 3});
  EXPECT_TRUE(show(3));
  second.reset();
  second.emplace(connect("second"));
  ask(*second, "engine-2", {9});
  EXPECT_TRUE(show(1));
}

}  // namespace
}  // namespace splatbus::gateway_test
