#include <nlohmann/json.hpp>

#include "launch_file.h"
#include "launch_keys.h"

namespace splatbus::cli {

namespace {

using Json = nlohmann::ordered_json;

/// A value that `${name}` stands for is a text, whatever it comes to.
Json or_variable(Json value) {
  return {{"anyOf", Json::array({std::move(value), {{"type", "string"}, {"pattern", "\\$\\{"}}})}};
}

Json scalar() {
  return {{"type", Json::array({"string", "number", "boolean"})}};
}

Json object_of(const std::vector<KeyRule>& rules);

Json value_of(const KeyRule& rule) {
  switch (rule.shape) {
    case Shape::Text:
      return scalar();
    case Shape::Number:
    case Shape::Integer: {
      Json number{{"type", rule.shape == Shape::Number ? "number" : "integer"}};
      if (rule.minimum > -1e18) number["minimum"] = rule.minimum;
      if (rule.maximum < 1e18) number["maximum"] = rule.maximum;
      return or_variable(std::move(number));
    }
    case Shape::Choice: {
      Json choice{{"enum", rule.choices}};
      if (!rule.keys.empty()) choice = {{"anyOf", Json::array({std::move(choice), object_of(rule.keys)})}};
      return or_variable(std::move(choice));
    }
    case Shape::TextList:
      return {{"type", "array"}, {"items", scalar()}};
    case Shape::TextMap:
      return {{"type", "object"}, {"additionalProperties", scalar()}};
    case Shape::Object:
      return object_of(rule.keys);
    case Shape::ObjectList: {
      const bool text_too = rule.name == "include";
      Json item = object_of(rule.keys);
      if (text_too) item = {{"anyOf", Json::array({{{"type", "string"}}, std::move(item)})}};
      return {{"type", "array"}, {"minItems", 1}, {"items", std::move(item)}};
    }
    case Shape::ObjectMap:
      return {{"type", "object"}, {"additionalProperties", {{"anyOf", Json::array({scalar(), object_of(rule.keys)})}}}};
  }
  return {};
}

Json object_of(const std::vector<KeyRule>& rules) {
  Json properties = Json::object();
  Json required = Json::array();
  for (const KeyRule& rule : rules) {
    Json value = value_of(rule);
    value["description"] = rule.text;
    properties[rule.name] = std::move(value);
    if (rule.required) required.push_back(rule.name);
  }
  Json object{{"type", "object"}, {"additionalProperties", false}, {"properties", std::move(properties)}};
  if (!required.empty()) object["required"] = std::move(required);
  return object;
}

}  // namespace

std::string launch_schema() {
  Json schema{{"$schema", "http://json-schema.org/draft-07/schema#"},
              {"title", "splatbus launch file"},
              {"description", "The processes of a splatbus pipeline; made by 'splatbus launch --schema'."}};
  schema.update(object_of(file_keys()));
  schema["anyOf"] = Json::array({{{"required", Json::array({"services"})}}, {{"required", Json::array({"include"})}}});
  return schema.dump(2) + "\n";
}

}  // namespace splatbus::cli
