#pragma once

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "gateway/foxglove/hub.h"
#include "wire/system_generated.h"

namespace splatbus::gateway::foxglove {

using nlohmann::json;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Pair;

inline constexpr bus::Rights kLooks{.view = true}, kControls{.view = true, .control = true};
inline const std::vector<std::uint8_t> kSchema{1, 2, 3, 255};

inline Offer offer(const std::string& topic, const std::string& schema = "a.Table") {
  return {.topic = topic, .schema_name = schema, .schema = kSchema, .publishers = {"engine"}};
}

/// A hub without sockets and without a bus, and clients of it.
class HubTest : public testing::Test {
 protected:
  struct Client {
    Hub::ClientId id = 0;
    int woken = 0;
  };
  Hub::Reception say(const Client& client, const json& message, const bus::Rights& rights = kControls,
                     std::int64_t now_ns = 0) {
    return say_text(client, message.dump(), rights, now_ns);
  }
  Hub::Reception say_text(const Client& client, const std::string& text, const bus::Rights& rights = kControls,
                          std::int64_t now_ns = 0, bool binary = false) {
    return hub_.receive(client.id, {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()}, binary, rights,
                        now_ns, asset_);
  }
  /// To a bus with nobody on it.
  void join(Client& client) {
    client.id = hub_.join([&client] { ++client.woken; });
    hub_.listed({}, 0);
  }
  /// All that waits for it: texts as JSON, binary ones as {"data": payload, "head": bytes}.
  std::vector<json> read(const Client& client) {
    std::vector<json> all;
    while (const auto message = hub_.take(client.id)) {
      if (!message->binary) {
        all.push_back(json::parse(message->head));
      } else {
        all.push_back({{"head", std::vector<std::uint8_t>(message->head.begin(), message->head.end())},
                       {"data", message->payload ? *message->payload : ""}});
      }
    }
    return all;
  }
  /// Those of them with that `op`.
  std::vector<json> read(const Client& client, const std::string& operation) {
    std::vector<json> all = read(client);
    std::erase_if(all, [&](const json& one) { return one.value("op", "") != operation; });
    return all;
  }
  void subscribe(const Client& client, std::uint32_t subscription, std::uint32_t channel) {
    say(client, {{"op", "subscribe"}, {"subscriptions", {{{"id", subscription}, {"channelId", channel}}}}});
  }
  void deliver(const std::string& topic, const std::string& text, const std::optional<std::string>& keep = {}) {
    hub_.deliver(topic, 0x0102030405060708, std::make_shared<const std::string>(text), keep);
  }

  Hub hub_{3, 1000, "session"};
  Client client_, other_;
  std::optional<Hub::AssetRequest> asset_;
};

}  // namespace splatbus::gateway::foxglove
