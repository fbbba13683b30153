// The hub's half about parameters.
#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "gateway/foxglove/hub.h"

namespace splatbus::gateway::foxglove {

namespace {

constexpr std::size_t kMaxSettings = 64, kMaxQuestions = 16;
constexpr std::int64_t kPatienceNs = 5'000'000'000;
// The bus says within a moment who is there, and each of these five times a second what it has.
constexpr std::int64_t kFirstWordsNs = 2'000'000'000;

}  // namespace

void Hub::get(Client& client, const ClientMessage& message, std::int64_t now_ns) {
  if (!board_.complete() && client.questions.size() < kMaxQuestions) {
    client.questions.push_back({message.names, message.request_id, now_ns + kFirstWordsNs});
  } else {
    send(client, parameter_values(board_.values(message.names), message.request_id));
  }
}

void Hub::answer_questions(Client& client, std::int64_t now_ns) {
  std::erase_if(client.questions, [&](const Question& question) {
    if (!board_.complete() && now_ns < question.until_ns) return false;
    send(client, parameter_values(board_.values(question.names), question.request_id));
    return true;
  });
}

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
      send(client, parameter_values(setting.names.empty() ? NamedParameters{} : board_.values(setting.names),
                                    setting.request_id));
    }
  }
  std::erase_if(client.settings, [](const Setting& setting) { return setting.open.empty(); });
}

void Hub::heard(const std::string& source, const NamedParameters& parameters, std::int64_t now_ns) {
  const std::scoped_lock lock(mutex_);
  if (clients_.empty()) return;
  tell_changed(board_.update(source, parameters, now_ns));
  for (auto& [id, client] : clients_) answer_questions(client, now_ns);
}

void Hub::listed(const std::map<std::string, bool>& sources, std::int64_t now_ns) {
  const std::scoped_lock lock(mutex_);
  if (clients_.empty()) return;
  const NamedParameters gone = board_.keep(sources, now_ns);
  for (auto& [id, client] : clients_) {
    for (const auto& one : gone) {
      const bool waits = std::ranges::any_of(
          client.settings, [name = &one.name](const Setting& setting) { return setting.open.contains(*name); });
      if (waits) say(client, Level::Error, fmt::format("parameter '{}': its service has ended", one.name));
    }
  }
  tell_changed(gone);
  for (auto& [id, client] : clients_) answer_questions(client, now_ns);
}

void Hub::tell_changed(const NamedParameters& changed) {
  if (changed.empty()) return;
  for (auto& [id, client] : clients_) {
    close_settings(client);
    NamedParameters told;
    for (const auto& one : changed) {
      if (client.all_parameters || client.parameters.contains(one.name)) told.push_back(one);
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
    answer_questions(client, now_ns);
    say_dropped(client, now_ns);
  }
}

}  // namespace splatbus::gateway::foxglove
