#include "parameter_query.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <set>
#include <stdexcept>

#include "bus/clock.h"
#include "bus/nearest.h"
#include "bus/subscriber.h"
#include "parameter_check.h"
#include "wire/system_generated.h"

namespace splatbus::cli {

namespace {

constexpr std::chrono::milliseconds kStep(50);
constexpr std::int64_t kQuietNs = 1'000'000'000;
constexpr std::int64_t kPatienceNs = 10'000'000'000;

ParameterOwner owner_of(const wire::Heartbeat& heartbeat) {
  ParameterOwner owner{.source = heartbeat.header()->source()->str(),
                       .kind = heartbeat.service()->str(),
                       .pid = heartbeat.pid(),
                       .values = {},
                       .types = {}};
  if (heartbeat.parameters() != nullptr) {
    for (const auto* entry : *heartbeat.parameters()) {
      owner.values.emplace_back(entry->key()->str(), entry->value()->str());
      owner.types[entry->key()->str()] = entry->type();
    }
  }
  return owner;
}

}  // namespace

const std::string* ParameterOwner::find(const std::string& key) const {
  const auto found = std::find_if(values.begin(), values.end(), [&](const auto& entry) { return entry.first == key; });
  return found == values.end() ? nullptr : &found->second;
}

std::vector<std::string> ParameterOwner::names() const {
  std::vector<std::string> result;
  for (const auto& [key, value] : values) result.push_back(key);
  return result;
}

std::vector<ParameterOwner> find_owners(const std::shared_ptr<bus::Context>& context, const std::string& name) {
  bus::Subscriber subscriber(context);
  std::optional<std::map<std::string, std::string>> alive;  // source to kind
  std::map<std::string, ParameterOwner> heard;
  subscriber.on(topics::kLiveness, [&](const wire::Liveness& liveness, const bus::Message&) {
    alive.emplace();
    if (liveness.nodes() == nullptr) return;
    for (const wire::Node* node : *liveness.nodes()) {
      if (node->alive()) alive->emplace(node->source()->str(), node->service()->str());
    }
  });
  subscriber.on(topics::kHeartbeat, [&](const wire::Heartbeat& heartbeat, const bus::Message&) {
    ParameterOwner owner = owner_of(heartbeat);
    heard.insert_or_assign(owner.source, std::move(owner));
  });
  for (const std::int64_t end_ns = bus::now_ns() + kPatienceNs; bus::now_ns() < end_ns;) {
    subscriber.dispatch_all(kStep);
    if (!alive) continue;
    std::vector<std::string> wanted;
    std::set<std::string> known;
    for (const auto& [source, kind] : *alive) {
      if (name.empty() || source == name || kind == name) wanted.push_back(source);
      known.insert({source, kind});
    }
    if (wanted.empty()) {
      throw std::runtime_error(fmt::format("no service '{}' on {}{}", name, context->address().text(),
                                           bus::suggestion(name, {known.begin(), known.end()})));
    }
    if (!std::all_of(wanted.begin(), wanted.end(), [&](const auto& source) { return heard.contains(source); }))
      continue;
    std::vector<ParameterOwner> owners;
    owners.reserve(wanted.size());
    for (const std::string& source : wanted) owners.push_back(heard.at(source));
    return owners;
  }
  throw std::runtime_error(fmt::format("the bus at {} says nothing of its services", context->address().text()));
}

std::optional<bus::ParameterReport> ask_program(const std::string& kind,
                                                const std::map<std::string, std::string>& changes,
                                                const std::filesystem::path& programs) {
  // The kind is what somebody on the bus says it is.
  const bool is_name = !kind.empty() && std::all_of(kind.begin(), kind.end(), [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '-';
  });
  const std::filesystem::path program = programs / ("splatbus-" + kind);
  if (!is_name || !std::filesystem::is_regular_file(program)) return {};
  std::vector<std::string> arguments;
  for (const auto& [key, value] : changes) {
    arguments.emplace_back("--set");
    arguments.push_back(fmt::format("{}={}", key, value));
  }
  return ask_parameters(program, arguments, {});
}

void send_control(bus::Publisher& publisher, const std::string& receiver,
                  const std::vector<std::pair<std::string, std::string>>& changes) {
  publisher.publish(topics::control("control/" + receiver), [&](auto& builder, auto header) {
    std::vector<flatbuffers::Offset<wire::KeyValue>> entries;
    entries.reserve(changes.size());
    for (const auto& [key, value] : changes) {
      entries.push_back(wire::CreateKeyValueDirect(builder, key.c_str(), value.c_str()));
    }
    return wire::CreateControl(builder, header, builder.CreateVector(entries));
  });
}

std::string set_parameter(const std::shared_ptr<bus::Context>& context, const ParameterOwner& owner,
                          const std::string& key, const std::string& value) {
  bus::Subscriber subscriber(context);
  // The service says at once what it has done, in a line of its log and then in a heartbeat of its own.
  const std::string done = fmt::format("{} set to {} by {}", key, value, context->source());
  const std::string by = fmt::format(" (asked for by {})", context->source());
  std::optional<std::string> refused, current;
  std::int64_t sent_ns = 0;
  bool said = false;
  subscriber.on(topics::kLog, [&](const wire::Log& log, const bus::Message& message) {
    if (message.header().source()->string_view() != owner.source || log.text() == nullptr) return;
    const std::string text = log.text()->str();
    said = said || text == done;
    if (log.level() == wire::LogLevel::Error && text.ends_with(by)) refused = text.substr(0, text.size() - by.size());
  });
  subscriber.on(topics::kHeartbeat, [&](const wire::Heartbeat& heartbeat, const bus::Message& message) {
    if (message.header().source()->string_view() != owner.source || sent_ns == 0) return;
    const ParameterOwner now = owner_of(heartbeat);
    const std::string* text = now.find(key);
    const std::string* before = owner.find(key);
    // Its log may be off: then a value that is another one, or that is the same a second later, is the answer.
    const bool settled =
        said || before == nullptr || (text != nullptr && *text != *before) || bus::now_ns() - sent_ns > kQuietNs;
    if (text != nullptr && settled) current = *text;
  });
  if (!context->wait_connected(std::chrono::seconds(10)) || !subscriber.wait_connected(std::chrono::seconds(10))) {
    throw std::runtime_error(fmt::format("no broker answers at {}", context->address().text()));
  }
  bus::Publisher publisher(context);
  sent_ns = bus::now_ns();
  send_control(publisher, owner.source, {{key, value}});
  const std::int64_t end_ns = sent_ns + kPatienceNs;
  while (bus::now_ns() < end_ns && !refused && !current) subscriber.dispatch_all(kStep);
  if (refused) throw std::runtime_error(*refused);
  if (!current) throw std::runtime_error(fmt::format("{} does not answer", owner.source));
  return *current;
}

}  // namespace splatbus::cli
