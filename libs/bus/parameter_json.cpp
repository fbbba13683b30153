#include "bus/parameter_json.h"

#include <fmt/format.h>

#include <charconv>
#include <cmath>
#include <nlohmann/json.hpp>

#include "bus/error.h"
#include "wire/system_generated.h"

namespace splatbus::bus {

using Json = nlohmann::json;

wire::ValueType value_type(const ParameterSpec& spec) {
  if (std::holds_alternative<bool>(spec.default_value)) return wire::ValueType::Boolean;
  if (std::holds_alternative<std::int64_t>(spec.default_value)) return wire::ValueType::Integer;
  if (std::holds_alternative<double>(spec.default_value)) return wire::ValueType::Number;
  return spec.choices.empty() ? wire::ValueType::Text : wire::ValueType::Choice;
}

ParameterValue typed_value(const std::string& text, wire::ValueType type) {
  const char* const end = text.data() + text.size();
  const auto reads = [&](auto& value) {
    const auto read = std::from_chars(text.data(), end, value);
    return read.ec == std::errc() && read.ptr == end;
  };
  std::int64_t whole = 0;
  double number = 0;
  if (type == wire::ValueType::Boolean && (text == "true" || text == "false")) return text == "true";
  if (type == wire::ValueType::Integer && reads(whole)) return whole;
  if (type == wire::ValueType::Number && reads(number) && std::isfinite(number)) return number;
  return text;
}

std::vector<ParameterDescription> describe(const Parameters& parameters) {
  std::vector<ParameterDescription> result;
  const auto values = parameters.list();
  for (std::size_t i = 0; i < values.size(); ++i) {
    const ParameterSpec& spec = parameters.specs()[i];
    result.push_back({.name = spec.name,
                      .type = type_name(spec),
                      .bounds = bounds_text(spec),
                      .default_value = to_text(spec.default_value),
                      .value = values[i].second,
                      .text = spec.description,
                      .at_start = spec.change == kFixed});
  }
  return result;
}

std::string to_json(const ParameterReport& report) {
  Json parameters = Json::array(), problems = Json::array();
  for (const ParameterDescription& p : report.parameters) {
    parameters.push_back({{"name", p.name},
                          {"type", p.type},
                          {"bounds", p.bounds},
                          {"default", p.default_value},
                          {"value", p.value},
                          {"text", p.text},
                          {"at_start", p.at_start}});
  }
  for (const ParameterProblem& p : report.problems) problems.push_back({{"parameter", p.parameter}, {"text", p.text}});
  return Json{{"parameters", parameters}, {"problems", problems}}.dump(-1, ' ', false, Json::error_handler_t::replace);
}

ParameterReport parse_parameter_report(const std::string& json) {
  try {
    ParameterReport report;
    const Json root = Json::parse(json);
    for (const Json& p : root.at("parameters")) {
      report.parameters.push_back({.name = p.at("name"),
                                   .type = p.at("type"),
                                   .bounds = p.at("bounds"),
                                   .default_value = p.at("default"),
                                   .value = p.at("value"),
                                   .text = p.at("text"),
                                   .at_start = p.at("at_start")});
    }
    for (const Json& p : root.at("problems")) report.problems.push_back({p.at("parameter"), p.at("text")});
    return report;
  } catch (const Json::exception& error) {
    throw Error(fmt::format("not a report of parameters: {}", error.what()));
  }
}

}  // namespace splatbus::bus
