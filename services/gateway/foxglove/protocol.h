#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace splatbus::wire {
enum class ValueType : std::uint8_t;
}

namespace splatbus::gateway::foxglove {

// Foxglove's WebSocket protocol, version 1. Its two subprotocols have the same messages as far as they are spoken here.
inline constexpr std::string_view kLegacySubprotocol = "foxglove.websocket.v1";
inline constexpr std::string_view kSdkSubprotocol = "foxglove.sdk.v1";

using Payload = std::shared_ptr<const std::string>;

/// One WebSocket message to a client: the head, and behind it a payload that several clients may share.
struct OutgoingMessage {
  bool binary = false;
  std::string head;
  Payload payload;  ///< may be null
  [[nodiscard]] std::size_t bytes() const { return head.size() + (payload ? payload->size() : 0); }
};

/// What a client can subscribe to.
struct Channel {
  std::uint32_t id = 0;
  std::string topic, encoding = "flatbuffer", schema_name;
  std::span<const std::uint8_t> schema;  ///< as the schema encoding "flatbuffer" has it; lives as long as the program
};

/// A parameter's value as the bus writes it, and the type that its service declares.
struct NamedParameter {
  std::string name;
  std::optional<std::string> value;  ///< none: it is no longer there
  wire::ValueType type{};
};
using NamedParameters = std::vector<NamedParameter>;

/// As a parameter's value has come from a client: what the bus would write, or nothing where the bus has no such type.
struct ParameterSetting {
  std::string name;
  std::optional<std::string> value;
};

/// A client's message; which members mean something follows from `operation`.
struct ClientMessage {
  enum class Operation : std::uint8_t {
    Subscribe,
    Unsubscribe,
    GetParameters,
    SetParameters,
    SubscribeParameters,
    UnsubscribeParameters,
    SubscribeGraph,
    UnsubscribeGraph,
    FetchAsset,
    Unsupported  ///< well-formed, and nothing that the server has said it can do
  };
  Operation operation = Operation::Unsupported;
  std::vector<std::pair<std::uint32_t, std::uint32_t>> subscriptions;  ///< id, channel id
  std::vector<std::uint32_t> ids;                                      ///< of subscriptions
  std::vector<std::string> names;                                      ///< of parameters
  std::vector<ParameterSetting> settings;
  std::optional<std::string> request_id;
  std::uint32_t asset_request = 0;
  std::string text;  ///< the asset's URI; the operation's name, where that is unsupported
};

/// Nullopt for what is none: no JSON, nested more than 8 deep, without `op`, with a field of another type, with more
/// than 4096 elements in a list.
[[nodiscard]] std::optional<ClientMessage> parse_text(std::string_view text);
/// The same of a binary message: those of clients are all for things that are not offered.
[[nodiscard]] std::optional<ClientMessage> parse_binary(std::span<const std::uint8_t> message);

/// Of a status.
enum class Level : std::uint8_t { Info, Warning, Error };

[[nodiscard]] OutgoingMessage server_info(const std::string& session_id);
[[nodiscard]] OutgoingMessage advertise(const std::vector<Channel>& channels);
[[nodiscard]] OutgoingMessage unadvertise(const std::vector<std::uint32_t>& channel_ids);
[[nodiscard]] OutgoingMessage status(Level level, const std::string& message, const std::string& id = {});
/// Each value is of its declared type. Where the service has said none, it is a number or a boolean where it reads like
/// one.
[[nodiscard]] OutgoingMessage parameter_values(const NamedParameters& values,
                                               const std::optional<std::string>& request_id = {});
/// Topics with those who publish, or subscribe to, them.
using Endpoints = std::vector<std::pair<std::string, std::vector<std::string>>>;
[[nodiscard]] OutgoingMessage connection_graph(const Endpoints& published, const Endpoints& subscribed,
                                               const std::vector<std::string>& removed);
/// Times: nanoseconds since 1970, UTC.
[[nodiscard]] OutgoingMessage message_data(std::uint32_t subscription_id, std::uint64_t time_ns, Payload payload);
[[nodiscard]] OutgoingMessage time(std::uint64_t time_ns);
/// `data`: null where it failed, and then `problem` says why.
[[nodiscard]] OutgoingMessage asset(std::uint32_t request_id, Payload data, const std::string& problem);

}  // namespace splatbus::gateway::foxglove
