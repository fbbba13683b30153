#include "message_filter.h"

#include <fmt/format.h>

#include <algorithm>
#include <regex>
#include <sstream>
#include <stdexcept>

namespace splatbus::cli {

using Json = nlohmann::json;

Json field_of(const Json& message, const std::string& path) {
  const Json* at = &message;
  std::istringstream parts(path);
  for (std::string part; std::getline(parts, part, '.');) {
    if (at->is_object()) {
      const auto found = at->find(part);
      if (found == at->end()) return nullptr;
      at = &*found;
    } else if (at->is_array() && !part.empty() && part.size() < 10 &&
               part.find_first_not_of("0123456789") == std::string::npos && std::stoul(part) < at->size()) {
      at = &(*at)[std::stoul(part)];
    } else {
      return nullptr;
    }
  }
  return *at;
}

std::vector<std::string> values_of(const Json& message, const std::vector<std::string>& paths) {
  std::vector<std::string> values;
  for (const std::string& path : paths) {
    const Json value = field_of(message, path);
    if (value.is_null()) {
      values.emplace_back();
    } else if (value.is_string()) {
      values.push_back(value.get<std::string>());
    } else {
      values.push_back(value.dump(-1, ' ', false, Json::error_handler_t::replace));
    }
  }
  return values;
}

std::string csv_line(const std::vector<std::string>& values) {
  std::string line;
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (i > 0) line += ',';
    if (values[i].find_first_of(",\"\r\n") == std::string::npos) {
      line += values[i];
      continue;
    }
    line += '"';
    for (const char c : values[i]) {
      if (c == '"') line += '"';
      line += c;
    }
    line += '"';
  }
  return line;
}

MessageFilter::MessageFilter(const std::string& expression) {
  static const std::regex term(R"(\s*([\w.]+)\s*(==|!=|<=|>=|<|>)\s*(.*?)\s*)");
  for (std::size_t begin = 0; begin <= expression.size();) {
    const std::size_t end = std::min(expression.find("&&", begin), expression.size());
    const std::string text = expression.substr(begin, end - begin);
    std::smatch match;
    if (!std::regex_match(text, match, term) || match[3].length() == 0) {
      throw std::runtime_error(fmt::format("filter '{}': '{}' is not FIELD OP VALUE", expression, text));
    }
    Json value = Json::parse(match[3].str(), nullptr, false);
    if (value.is_discarded()) value = match[3].str();
    terms_.push_back({match[1], match[2], std::move(value)});
    begin = end + 2;
  }
}

bool MessageFilter::holds(const Json& message) const {
  for (const Term& term : terms_) {
    const Json value = field_of(message, term.path);
    const bool comparable = value.type() == term.value.type() || (value.is_number() && term.value.is_number());
    const std::string& op = term.operation;
    bool is = op == "!=";
    if (comparable) {
      is = op == "=="   ? value == term.value
           : op == "!=" ? value != term.value
           : op == "<"  ? value < term.value
           : op == "<=" ? value <= term.value
           : op == ">"  ? value > term.value
                        : value >= term.value;
    }
    if (!is) return false;
  }
  return true;
}

}  // namespace splatbus::cli
