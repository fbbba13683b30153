#include "gateway/foxglove/protocol.h"

#include <openssl/evp.h>

#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <variant>

#include "bus/parameter_json.h"
#include "wire/system_generated.h"

namespace splatbus::gateway::foxglove {

namespace {

using Json = nlohmann::json;
using Operation = ClientMessage::Operation;

constexpr int kMaxDepth = 8;
constexpr std::size_t kMaxElements = 4096;

OutgoingMessage text_message(const Json& json) {
  return {.head = json.dump(-1, ' ', false, Json::error_handler_t::replace)};
}

void append(std::string& out, std::uint64_t value, int bytes) {
  for (int i = 0; i < bytes; ++i) out += static_cast<char>(value >> (8 * i));
}

std::string base64(std::span<const std::uint8_t> data) {
  std::string text(4 * ((data.size() + 2) / 3),
                   '\0');  // the zero behind it, which OpenSSL writes, is std::string's own
  ::EVP_EncodeBlock(reinterpret_cast<unsigned char*>(text.data()), data.data(), static_cast<int>(data.size()));
  return text;
}

/// Stops at what is nested too deep before it is built.
Json parse_json(std::string_view text) {
  bool too_deep = false;
  const auto keep = [&](int depth, Json::parse_event_t, Json&) {
    too_deep = too_deep || depth > kMaxDepth;
    return !too_deep;
  };
  Json json = Json::parse(text, keep, false);
  return too_deep ? Json(Json::value_t::discarded) : json;
}

/// What the messages' fields are read with; `wrong` is set by the first that is not what it has to be.
struct Reader {
  bool wrong = false;

  const Json& list(const Json& object, const char* name) {
    static const Json none = Json::array();
    const auto found = object.find(name);
    if (found != object.end() && found->is_array() && found->size() <= kMaxElements) return *found;
    wrong = true;
    return none;
  }
  std::uint32_t number(const Json& value) {
    if (value.is_number_unsigned() && value.get<std::uint64_t>() <= std::numeric_limits<std::uint32_t>::max()) {
      return value.get<std::uint32_t>();
    }
    wrong = true;
    return 0;
  }
  std::uint32_t number(const Json& object, const char* name) {
    const auto found = object.is_object() ? object.find(name) : object.end();
    return found != object.end() ? number(*found) : number(Json());
  }
  std::string text(const Json& value) {
    if (value.is_string()) return value.get<std::string>();
    wrong = true;
    return {};
  }
  std::string text(const Json& object, const char* name) {
    const auto found = object.is_object() ? object.find(name) : object.end();
    return found != object.end() ? text(*found) : text(Json());
  }
  std::optional<std::string> optional_text(const Json& object, const char* name) {
    const auto found = object.find(name);
    if (found == object.end() || found->is_null()) return std::nullopt;
    return text(*found);
  }
};

std::optional<std::string> value_for_bus(const Json& value) {
  if (value.is_boolean()) return value.get<bool>() ? "true" : "false";
  if (value.is_string()) return value.get<std::string>();
  if (value.is_number_integer()) return value.dump();
  if (!value.is_number_float() || !std::isfinite(value.get<double>())) return std::nullopt;
  // Clients in JavaScript have one kind of number, and write 3.0 as 3; what others write as 3.0 is the same.
  const auto number = value.get<double>();
  if (number == std::floor(number) && std::abs(number) < 1e15) return std::to_string(static_cast<std::int64_t>(number));
  return value.dump();
}

Json value_for_client(const std::string& text, wire::ValueType type) {
  using wire::ValueType;
  bus::ParameterValue value = bus::typed_value(text, type);
  if (type == ValueType::Unsaid) {
    for (const ValueType guess : {ValueType::Boolean, ValueType::Integer, ValueType::Number}) {
      if (std::holds_alternative<std::string>(value)) value = bus::typed_value(text, guess);
    }
  }
  return std::visit([](const auto& typed) { return Json(typed); }, value);
}

void read_fields(const Json& json, const std::string& name, ClientMessage& message, Reader& read) {
  const auto names = [&] {
    for (const Json& one : read.list(json, "parameterNames")) message.names.push_back(read.text(one));
  };
  if (name == "subscribe") {
    message.operation = Operation::Subscribe;
    for (const Json& one : read.list(json, "subscriptions")) {
      message.subscriptions.emplace_back(read.number(one, "id"), read.number(one, "channelId"));
    }
  } else if (name == "unsubscribe") {
    message.operation = Operation::Unsubscribe;
    for (const Json& one : read.list(json, "subscriptionIds")) message.ids.push_back(read.number(one));
  } else if (name == "getParameters") {
    message.operation = Operation::GetParameters;
    message.request_id = read.optional_text(json, "id");
    names();
  } else if (name == "setParameters") {
    message.operation = Operation::SetParameters;
    message.request_id = read.optional_text(json, "id");
    for (const Json& one : read.list(json, "parameters")) {
      const std::string parameter = read.text(one, "name");
      const auto value = one.is_object() ? one.find("value") : one.end();
      message.settings.push_back({parameter, value != one.end() ? value_for_bus(*value) : std::nullopt});
    }
  } else if (name == "subscribeParameterUpdates" || name == "unsubscribeParameterUpdates") {
    message.operation = name.starts_with('s') ? Operation::SubscribeParameters : Operation::UnsubscribeParameters;
    names();
  } else if (name == "subscribeConnectionGraph") {
    message.operation = Operation::SubscribeGraph;
  } else if (name == "unsubscribeConnectionGraph") {
    message.operation = Operation::UnsubscribeGraph;
  } else if (name == "fetchAsset") {
    message.operation = Operation::FetchAsset;
    message.asset_request = read.number(json, "requestId");
    message.text = read.text(json, "uri");
  } else {
    message.text = name;
  }
}

Json endpoints(const Endpoints& topics, const char* of_topic) {
  Json list = Json::array();
  for (const auto& [topic, ids] : topics) list.push_back({{"name", topic}, {of_topic, ids}});
  return list;
}

}  // namespace

std::optional<ClientMessage> parse_text(std::string_view text) {
  const Json json = parse_json(text);
  if (!json.is_object()) return std::nullopt;
  ClientMessage message;
  Reader read;
  const std::string name = read.text(json, "op");
  read_fields(json, name, message, read);
  if (read.wrong) return std::nullopt;
  return message;
}

std::optional<ClientMessage> parse_binary(std::span<const std::uint8_t> message) {
  // Message data; a service call.
  constexpr std::size_t kMessageHead = 5, kCallHead = 13;
  ClientMessage parsed;
  if (message.size() >= kMessageHead && message[0] == 1) {
    parsed.text = "publishing";
  } else if (message.size() >= kCallHead && message[0] == 2) {
    parsed.text = "service calls";
  } else {
    return std::nullopt;
  }
  return parsed;
}

OutgoingMessage server_info(const std::string& session_id) {
  return text_message({{"op", "serverInfo"},
                       {"name", "splatbus"},
                       {"capabilities", {"parameters", "parametersSubscribe", "time", "connectionGraph", "assets"}},
                       {"metadata", Json::object()},
                       {"sessionId", session_id}});
}

OutgoingMessage advertise(const std::vector<Channel>& channels) {
  Json list = Json::array();
  for (const Channel& channel : channels) {
    list.push_back({{"id", channel.id},
                    {"topic", channel.topic},
                    {"encoding", channel.encoding},
                    {"schemaName", channel.schema_name},
                    {"schemaEncoding", "flatbuffer"},
                    {"schema", base64(channel.schema)}});
  }
  return text_message({{"op", "advertise"}, {"channels", std::move(list)}});
}

OutgoingMessage unadvertise(const std::vector<std::uint32_t>& channel_ids) {
  return text_message({{"op", "unadvertise"}, {"channelIds", channel_ids}});
}

OutgoingMessage status(Level level, const std::string& message, const std::string& id) {
  Json json{{"op", "status"}, {"level", static_cast<int>(level)}, {"message", message}};
  if (!id.empty()) json["id"] = id;
  return text_message(json);
}

OutgoingMessage parameter_values(const NamedParameters& values, const std::optional<std::string>& request_id) {
  Json list = Json::array();
  for (const auto& [name, value, type] : values) {
    Json parameter{{"name", name}};
    if (value) parameter["value"] = value_for_client(*value, type);
    if (value && parameter["value"].is_number_float()) parameter["type"] = "float64";
    list.push_back(std::move(parameter));
  }
  Json json{{"op", "parameterValues"}, {"parameters", std::move(list)}};
  if (request_id) json["id"] = *request_id;
  return text_message(json);
}

OutgoingMessage connection_graph(const Endpoints& published, const Endpoints& subscribed,
                                 const std::vector<std::string>& removed) {
  return text_message({{"op", "connectionGraphUpdate"},
                       {"publishedTopics", endpoints(published, "publisherIds")},
                       {"subscribedTopics", endpoints(subscribed, "subscriberIds")},
                       {"advertisedServices", Json::array()},
                       {"removedTopics", removed},
                       {"removedServices", Json::array()}});
}

OutgoingMessage message_data(std::uint32_t subscription_id, std::uint64_t time_ns, Payload payload) {
  OutgoingMessage message{.binary = true, .head = "\x01", .payload = std::move(payload)};
  append(message.head, subscription_id, 4);
  append(message.head, time_ns, 8);
  return message;
}

OutgoingMessage time(std::uint64_t time_ns) {
  OutgoingMessage message{.binary = true, .head = "\x02"};
  append(message.head, time_ns, 8);
  return message;
}

OutgoingMessage asset(std::uint32_t request_id, Payload data, const std::string& problem) {
  OutgoingMessage message{.binary = true, .head = "\x04"};
  append(message.head, request_id, 4);
  append(message.head, data ? 0 : 1, 1);
  append(message.head, data ? 0 : problem.size(), 4);
  if (!data) message.head += problem;
  message.payload = std::move(data);
  return message;
}

}  // namespace splatbus::gateway::foxglove
