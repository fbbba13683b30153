#include "gateway/foxglove/parameter_board.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>

namespace splatbus::gateway::foxglove {

namespace {

constexpr std::size_t kMaxServices = 64, kMaxOfSource = 256;

std::optional<double> number(const std::string& text) {
  double value = 0;
  const auto read = std::from_chars(text.data(), text.data() + text.size(), value);
  if (read.ec != std::errc() || read.ptr != text.data() + text.size()) return std::nullopt;
  return value;
}

}  // namespace

NamedValues ParameterBoard::update(const std::string& source, const NamedValues& parameters) {
  NamedValues changed;
  std::size_t taken = 0;
  for (const auto& [key, value] : parameters) {
    if (++taken > kMaxOfSource || parameters_.size() >= kMaxServices * kMaxOfSource) break;
    const std::string name = fmt::format("{}/{}", source, key);
    Parameter& known = parameters_[name];
    if (known.source == source && known.value == value) continue;
    known = {source, key, value};
    changed.emplace_back(name, value);
  }
  return changed;
}

const ParameterBoard::Parameter* ParameterBoard::find(const std::string& name) const {
  const auto found = parameters_.find(name);
  return found == parameters_.end() ? nullptr : &found->second;
}

NamedValues ParameterBoard::values(const std::vector<std::string>& names) const {
  NamedValues values;
  if (names.empty()) {
    for (const auto& [name, parameter] : parameters_) values.emplace_back(name, parameter.value);
  }
  for (const std::string& name : names) {
    if (const Parameter* parameter = find(name)) values.emplace_back(name, parameter->value);
  }
  return values;
}

bool same_value(const std::string& a, const std::string& b) {
  if (a == b) return true;
  const auto x = number(a), y = number(b);
  return x && y && std::abs(*x - *y) <= 1e-6 * std::max(std::abs(*x), std::abs(*y));
}

}  // namespace splatbus::gateway::foxglove
