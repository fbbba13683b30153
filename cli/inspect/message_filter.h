#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace splatbus::cli {

/// A field of a message in JSON, by names and indices with dots between: "cameras.0.camera.id". Null where it has none.
[[nodiscard]] nlohmann::json field_of(const nlohmann::json& message, const std::string& path);

/// Each field as text; strings bare, what is missing empty.
[[nodiscard]] std::vector<std::string> values_of(const nlohmann::json& message, const std::vector<std::string>& paths);

/// By RFC 4180, without the line's end.
[[nodiscard]] std::string csv_line(const std::vector<std::string>& values);

/// "FIELD OP VALUE", several with && between. VALUE is JSON, or a bare word for a text.
class MessageFilter {
 public:
  /// Throws std::runtime_error that names what makes no sense.
  explicit MessageFilter(const std::string& expression);
  /// Of different types, or of a field that is missing, only != holds.
  [[nodiscard]] bool holds(const nlohmann::json& message) const;

 private:
  struct Term {
    std::string path, operation;
    nlohmann::json value;
  };
  std::vector<Term> terms_;
};

}  // namespace splatbus::cli
