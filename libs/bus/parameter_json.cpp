#include "bus/parameter_json.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "bus/error.h"

namespace splatbus::bus {

using Json = nlohmann::json;

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
