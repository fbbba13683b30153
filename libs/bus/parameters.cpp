#include "bus/parameters.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cassert>
#include <charconv>
#include <cmath>
#include <optional>

#include "bus/nearest.h"

namespace splatbus::bus {
namespace {

template <class T>
std::optional<T> parse_number(const std::string& text) {
  T value{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return value;
}

/// A bound that somebody chose, and not the type's own.
bool is_bound(double bound) {
  return std::abs(bound) < 1e18;
}

std::optional<bool> parse_boolean(const std::string& text) {
  if (text == "true" || text == "1" || text == "on" || text == "yes") return true;
  if (text == "false" || text == "0" || text == "off" || text == "no") return false;
  return std::nullopt;
}

std::string suggestion_of(const std::string& text, const std::vector<std::string>& choices) {
  const std::string meant = nearest(text, choices);
  return meant.empty() ? "" : fmt::format("; did you mean '{}'?", meant);
}

// The value, or what is wrong with it.
std::variant<ParameterValue, std::string> parse_value(const ParameterSpec& spec, const std::string& text) {
  const auto refuse = [&](const std::string& expected) { return fmt::format("must be {}, not '{}'", expected, text); };
  if (std::holds_alternative<bool>(spec.default_value)) {
    const auto value = parse_boolean(text);
    if (!value) return refuse("true or false");
    return ParameterValue(*value);
  }
  if (std::holds_alternative<std::string>(spec.default_value)) {
    const bool known =
        spec.choices.empty() || std::find(spec.choices.begin(), spec.choices.end(), text) != spec.choices.end();
    if (!known) return refuse(bounds_text(spec)) + suggestion_of(text, spec.choices);
    if (spec.rule.holds && !spec.rule.holds(text)) return refuse(spec.rule.expected);
    return ParameterValue(text);
  }
  const auto in_range = [&](const std::string& kind) {
    const std::string bounds = bounds_text(spec);
    return bounds.empty() ? kind : fmt::format("{} {}", kind, bounds);
  };
  if (std::holds_alternative<std::int64_t>(spec.default_value)) {
    const auto value = parse_number<std::int64_t>(text);
    const auto number = static_cast<double>(value.value_or(0));
    if (!value || number < spec.range.minimum || number > spec.range.maximum) return refuse(in_range("a whole number"));
    return ParameterValue(*value);
  }
  const auto value = parse_number<double>(text);
  if (!value || !std::isfinite(*value) || *value < spec.range.minimum || *value > spec.range.maximum) {
    return refuse(in_range("a number"));
  }
  return ParameterValue(*value);
}

}  // namespace

std::string to_text(const ParameterValue& value) {
  if (const auto* boolean = std::get_if<bool>(&value)) return *boolean ? "true" : "false";
  if (const auto* integer = std::get_if<std::int64_t>(&value)) return fmt::format("{}", *integer);
  if (const auto* number = std::get_if<double>(&value)) return fmt::format("{}", *number);
  return std::get<std::string>(value);
}

std::string type_name(const ParameterSpec& spec) {
  if (std::holds_alternative<bool>(spec.default_value)) return "boolean";
  if (std::holds_alternative<std::int64_t>(spec.default_value)) return "integer";
  if (std::holds_alternative<double>(spec.default_value)) return "number";
  return spec.choices.empty() ? "text" : "choice";
}

std::string bounds_text(const ParameterSpec& spec) {
  if (std::holds_alternative<bool>(spec.default_value)) return "true or false";
  if (std::holds_alternative<std::string>(spec.default_value)) {
    if (spec.choices.empty()) return spec.rule.expected;
    return fmt::format("{}", fmt::join(spec.choices, spec.choices.size() == 2 ? " or " : ", "));
  }
  const auto [minimum, maximum] = spec.range;
  const bool above = is_bound(minimum), below = is_bound(maximum);
  if (above && below) return fmt::format("from {} to {}", minimum, maximum);
  if (above) return fmt::format("at least {}", minimum);
  return below ? fmt::format("at most {}", maximum) : "";
}

std::string problem_of(const ParameterSpec& spec, const std::string& text) {
  const auto parsed = parse_value(spec, text);
  const auto* problem = std::get_if<std::string>(&parsed);
  return problem != nullptr ? *problem : "";
}

double ParameterBinder::as_written(float member, double unit) {
  return unit == 1 ? std::stod(fmt::format("{}", member)) : std::stod(fmt::format("{:.6g}", member / unit));
}

double ParameterBinder::as_written(double member, double unit) {
  return unit == 1 ? member : std::stod(fmt::format("{:.12g}", member / unit));
}

void ParameterBinder::declare(ParameterSpec spec) {
  specs_->push_back(std::move(spec));
}

void ParameterBinder::add(const std::string& name, bool& member, const std::string& description, Change change) {
  if (values_ != nullptr) {
    member = std::get<bool>(values_->at(name));
  } else {
    declare({name, member, description, {}, {}, change});
  }
}

void ParameterBinder::add(const std::string& name, std::string& member, const std::string& description, Change change) {
  if (values_ != nullptr) {
    member = std::get<std::string>(values_->at(name));
  } else {
    declare({name, member, description, {}, {}, change});
  }
}

void ParameterBinder::add(const std::string& name, std::string& member, const std::string& description, TextRule rule,
                          Change change) {
  if (values_ != nullptr) {
    member = std::get<std::string>(values_->at(name));
  } else {
    declare({name, member, description, {}, {}, change, std::move(rule)});
  }
}

Parameters::Parameters(std::vector<ParameterSpec> specs) : specs_(std::move(specs)) {
  for (const auto& spec : specs_) {
    [[maybe_unused]] const bool inserted = values_.emplace(spec.name, spec.default_value).second;
    assert(inserted && "a parameter is declared twice");
  }
}

std::string Parameters::set(const std::string& name, const std::string& text, bool at_runtime) {
  const auto spec = std::find_if(specs_.begin(), specs_.end(),
                                 [&](const ParameterSpec& candidate) { return candidate.name == name; });
  if (spec == specs_.end()) {
    std::vector<std::string> known;
    for (const auto& candidate : specs_) known.push_back(candidate.name);
    return fmt::format("no parameter '{}' to set to '{}'{}", name, text, suggestion(name, known));
  }
  if (at_runtime && spec->change == kFixed) {
    return fmt::format("parameter '{}' is fixed while the service runs: restart it with '{}'", name, text);
  }
  const auto parsed = parse_value(*spec, text);
  if (const auto* problem = std::get_if<std::string>(&parsed)) return fmt::format("parameter '{}' {}", name, *problem);
  const std::scoped_lock lock(mutex_);
  values_[name] = std::get<ParameterValue>(parsed);
  ++version_;
  return {};
}

std::uint64_t Parameters::version() const {
  const std::scoped_lock lock(mutex_);
  return version_;
}

std::vector<std::pair<std::string, std::string>> Parameters::list() const {
  const std::scoped_lock lock(mutex_);
  std::vector<std::pair<std::string, std::string>> result;
  for (const auto& spec : specs_) result.emplace_back(spec.name, to_text(values_.at(spec.name)));
  return result;
}

}  // namespace splatbus::bus
