// The hub's half about parameters.
#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "gateway/foxglove/hub.h"

namespace splatbus::gateway::foxglove {

namespace {

constexpr std::size_t kMaxSettings = 64;
constexpr std::int64_t kPatienceNs = 5'000'000'000;

}  // namespace

Hub::Reception Hub::set(Client& client, const ClientMessage& message, const bus::Rights& rights, std::int64_t now_ns) {
  if (!rights.control) {
    say(client, Level::Error, "setting parameters needs a token with the right to control");
    if (message.request_id) send(client, parameter_values({}, message.request_id));
    return Reception::Forbidden;
  }
  Setting setting{.request_id = message.request_id, .until_ns = now_ns + kPatienceNs};
  std::map<std::string, NamedValues> changes;
  for (const auto& [name, value] : message.settings) {
    const ParameterBoard::Parameter* known = board_.find(name);
    if (known == nullptr) {
      say(client, Level::Error, fmt::format("there is no parameter '{:.256}'", name));
    } else if (!value) {
      say(client, Level::Error, fmt::format("parameter '{}': a number, a boolean or a text was expected", name));
    } else {
      setting.names.push_back(name);
      setting.open[name] = *value;
      changes[known->source].emplace_back(known->key, *value);
    }
  }
  if (client.settings.size() >= kMaxSettings) {
    say(client, Level::Error, "too many settings wait for their services");
    return Reception::Understood;
  }
  for (const auto& [source, values] : changes) {
    if (set_) set_(source, values);
  }
  client.settings.push_back(std::move(setting));
  close_settings(client);
  return Reception::Understood;
}

void Hub::close_settings(Client& client) {
  for (Setting& setting : client.settings) {
    std::erase_if(setting.open, [&](const auto& asked) {
      const ParameterBoard::Parameter* known = board_.find(asked.first);
      return known == nullptr || same_value(known->value, asked.second);
    });
    if (setting.open.empty() && setting.request_id) {
      send(client,
           parameter_values(setting.names.empty() ? NamedValues{} : board_.values(setting.names), setting.request_id));
    }
  }
  std::erase_if(client.settings, [](const Setting& setting) { return setting.open.empty(); });
}

void Hub::heard(const std::string& source, const NamedValues& parameters) {
  const std::scoped_lock lock(mutex_);
  if (clients_.empty()) return;
  const NamedValues changed = board_.update(source, parameters);
  if (changed.empty()) return;
  for (auto& [id, client] : clients_) {
    close_settings(client);
    NamedValues told;
    for (const auto& one : changed) {
      if (client.all_parameters || client.parameters.contains(one.first)) told.push_back(one);
    }
    if (!told.empty()) send(client, parameter_values(told));
  }
}

void Hub::logged_error(const std::string& source, const std::string& text) {
  const std::scoped_lock lock(mutex_);
  for (auto& entry : clients_) {
    auto& client = entry.second;  // clang 14 lets no lambda take a structured binding
    for (Setting& setting : client.settings) {
      std::erase_if(setting.open, [&](const auto& asked) {
        const ParameterBoard::Parameter* known = board_.find(asked.first);
        if (known == nullptr || known->source != source || text.find("'" + known->key + "'") == std::string::npos) {
          return false;
        }
        say(client, Level::Error, fmt::format("{}: {}", source, text));
        return true;
      });
    }
    close_settings(client);
  }
}

void Hub::expire(std::int64_t now_ns) {
  const std::scoped_lock lock(mutex_);
  for (auto& [id, client] : clients_) {
    for (Setting& setting : client.settings) {
      if (now_ns < setting.until_ns) continue;
      for (const auto& [name, value] : setting.open) {
        say(client, Level::Warning, fmt::format("parameter '{}' has not become '{:.64}' yet", name, value));
      }
      setting.open.clear();
    }
    close_settings(client);
    say_dropped(client, now_ns);
  }
}

}  // namespace splatbus::gateway::foxglove
