#pragma once

#include <cstdint>
#include <map>
#include <mutex>
#include <string>
#include <utility>
#include <variant>
#include <vector>

namespace splatbus::bus {

using ParameterValue = std::variant<bool, std::int64_t, double, std::string>;

/// One parameter as declared: its default gives its type.
struct ParameterSpec {
  std::string name;
  ParameterValue default_value;
  std::string description;  ///< with its unit
  double minimum = -1e300;  ///< numbers only
  double maximum = 1e300;
  std::vector<std::string> choices;  ///< strings only; empty: any
  bool runtime = true;               ///< false: fixed once the service has started
};

/// A service's parameters: declared once, set by `--set name=value` and by control/<service>. Thread-safe.
class Parameters {
 public:
  explicit Parameters(std::vector<ParameterSpec> specs);

  /// Parses, checks and sets; booleans are true/false, 1/0, on/off or yes/no. Returns an empty string, or what was
  /// wrong, in words that name parameter and value.
  [[nodiscard]] std::string set(const std::string& name, const std::string& text, bool at_runtime);

  [[nodiscard]] bool boolean(const std::string& name) const;  ///< asserts that it was declared as bool
  [[nodiscard]] std::int64_t integer(const std::string& name) const;
  [[nodiscard]] double number(const std::string& name) const;
  [[nodiscard]] std::string text(const std::string& name) const;

  [[nodiscard]] std::uint64_t version() const;  ///< grows with every change
  [[nodiscard]] std::vector<std::pair<std::string, std::string>> list() const;
  [[nodiscard]] const std::vector<ParameterSpec>& specs() const { return specs_; }

 private:
  template <class T>
  [[nodiscard]] T value(const std::string& name) const;

  const std::vector<ParameterSpec> specs_;
  mutable std::mutex mutex_;
  std::map<std::string, ParameterValue> values_;
  std::uint64_t version_ = 0;
};

}  // namespace splatbus::bus
