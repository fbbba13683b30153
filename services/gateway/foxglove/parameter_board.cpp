#include "gateway/foxglove/parameter_board.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>

namespace splatbus::gateway::foxglove {

namespace {

constexpr std::size_t kMaxServices = 64, kMaxOfSource = 256;
constexpr std::size_t kMaxHeard = 1024;            // as many as the broker lists
constexpr std::int64_t kSilentNs = 3'000'000'000;  // the broker calls 2 s silence, and says so once a second

std::optional<double> number(const std::string& text) {
  double value = 0;
  const auto read = std::from_chars(text.data(), text.data() + text.size(), value);
  if (read.ec != std::errc() || read.ptr != text.data() + text.size()) return std::nullopt;
  return value;
}

}  // namespace

NamedParameters ParameterBoard::update(const std::string& source, const NamedParameters& parameters,
                                       std::int64_t now_ns) {
  if (heard_ns_.size() < kMaxHeard || heard_ns_.contains(source)) heard_ns_[source] = now_ns;
  awaited_.erase(source);
  look_whether_complete();
  NamedParameters changed;
  std::set<std::string> named;
  for (const auto& [key, value, type] : parameters) {
    if (named.size() >= kMaxOfSource) break;
    const std::string name = fmt::format("{}/{}", source, key);
    if (parameters_.size() >= kMaxServices * kMaxOfSource && !parameters_.contains(name)) continue;
    named.insert(key);
    Parameter& known = parameters_[name];
    if (known.source == source && known.value == value && known.type == type) continue;
    known = {source, key, value.value_or(""), type};
    changed.push_back({name, value, type});
  }
  const NamedParameters gone =
      take_off([&](const Parameter& one) { return one.source == source && !named.contains(one.key); });
  changed.insert(changed.end(), gone.begin(), gone.end());
  return changed;
}

NamedParameters ParameterBoard::keep(const std::map<std::string, bool>& sources, std::int64_t now_ns) {
  listed_ = true;
  awaited_.clear();
  for (const auto& [source, alive] : sources) {
    if (alive && !heard_ns_.contains(source)) awaited_.insert(source);
  }
  look_whether_complete();
  std::erase_if(heard_ns_, [&](const auto& heard) {
    const auto listed = sources.find(heard.first);
    return listed == sources.end() ? now_ns - heard.second > kSilentNs : !listed->second;
  });
  return take_off([&](const Parameter& one) { return !heard_ns_.contains(one.source); });
}

template <class Condition>
NamedParameters ParameterBoard::take_off(Condition condition) {
  NamedParameters gone;
  std::erase_if(parameters_, [&](const auto& one) {
    if (!condition(one.second)) return false;
    gone.push_back({one.first, std::nullopt});
    return true;
  });
  return gone;
}

void ParameterBoard::look_whether_complete() {
  complete_ = complete_ || (listed_ && awaited_.empty());
}

const ParameterBoard::Parameter* ParameterBoard::find(const std::string& name) const {
  const auto found = parameters_.find(name);
  return found == parameters_.end() ? nullptr : &found->second;
}

NamedParameters ParameterBoard::values(const std::vector<std::string>& names) const {
  NamedParameters values;
  if (names.empty()) {
    for (const auto& [name, parameter] : parameters_) values.push_back({name, parameter.value, parameter.type});
  }
  for (const std::string& name : names) {
    if (const Parameter* parameter = find(name)) values.push_back({name, parameter->value, parameter->type});
  }
  return values;
}

bool same_value(const std::string& a, const std::string& b) {
  if (a == b) return true;
  const auto x = number(a), y = number(b);
  return x && y && std::abs(*x - *y) <= 1e-6 * std::max(std::abs(*x), std::abs(*y));
}

}  // namespace splatbus::gateway::foxglove
