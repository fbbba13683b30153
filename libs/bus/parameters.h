#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>
#include <map>
#include <mutex>
#include <numbers>
#include <string>
#include <type_traits>
#include <utility>
#include <variant>
#include <vector>

#include "bus/text_rules.h"

namespace splatbus::bus {

using ParameterValue = std::variant<bool, std::int64_t, double, std::string>;

/// Bounds of a number, both included. What is left out is the type's own.
struct Range {
  double minimum = -1e300;
  double maximum = 1e300;
};

enum class Change : std::uint8_t { AtStart, AnyTime };
inline constexpr Change kFixed = Change::AtStart;  ///< once the service has started
inline constexpr Change kRuntime = Change::AnyTime;

/// Units of parameters whose members are in radians and bytes.
inline constexpr double kDegrees = std::numbers::pi / 180;
inline constexpr double kMebibytes = 1 << 20;

/// One parameter as declared: its default gives its type.
struct ParameterSpec {
  std::string name;
  ParameterValue default_value;
  std::string description;           ///< with its unit
  Range range;                       ///< numbers only
  std::vector<std::string> choices;  ///< strings only; empty: any
  Change change = kRuntime;
  TextRule rule{};  ///< strings only, and only where `holds` is set
};

/// "boolean", "integer", "number", "text" or "choice".
[[nodiscard]] std::string type_name(const ParameterSpec& spec);
/// What it may be set to, in words: "from 0 to 1", "at least 0", "ring or follow", "true or false"; empty: anything.
[[nodiscard]] std::string bounds_text(const ParameterSpec& spec);
/// Empty when set() takes the text, else what is wrong: "must be a whole number from 1 to 8, not 'x'".
[[nodiscard]] std::string problem_of(const ParameterSpec& spec, const std::string& text);
/// A value as set() takes it.
[[nodiscard]] std::string to_text(const ParameterValue& value);

/// Ties a service's parameters to the members of a struct. The struct has `void bind(ParameterBinder&)`, which adds
/// each of its members; the member's initialiser is the parameter's default, and stands nowhere else:
///   struct Options {
///     int batch = 2;
///     void bind(bus::ParameterBinder& p) { p.add("batch", batch, "views a step", {1, 16}); }
///   };
/// Parameters::declare<Options>() and Parameters::read<Options>() both run it. What follows from members may be
/// computed at its end.
class ParameterBinder {
 public:
  /// One that declares into `specs`, and one that writes `values` to the members.
  explicit ParameterBinder(std::vector<ParameterSpec>& specs) : specs_(&specs) {}
  explicit ParameterBinder(const std::map<std::string, ParameterValue>& values) : values_(&values) {}

  /// A number; the member is the parameter times `unit`.
  template <class T>
  requires(std::is_arithmetic_v<T> &&
           !std::is_same_v<T, bool>) void add(const std::string& name, T& member, const std::string& description,
                                              Range range = {}, Change change = kRuntime, double unit = 1) {
    if (values_ != nullptr) {
      member = std::visit([unit](const auto& value) { return scaled<T>(value, unit); }, values_->at(name));
      return;
    }
    using Limits = std::numeric_limits<T>;
    range.minimum = std::max(range.minimum, static_cast<double>(Limits::lowest()) / unit);
    range.maximum = std::min(range.maximum, static_cast<double>(Limits::max()) / unit);
    if constexpr (std::is_integral_v<T>) {
      declare(
          {name, static_cast<std::int64_t>(member) / static_cast<std::int64_t>(unit), description, range, {}, change});
    } else {
      declare({name, as_written(member, unit), description, range, {}, change});
    }
  }
  void add(const std::string& name, bool& member, const std::string& description, Change change = kRuntime);
  void add(const std::string& name, std::string& member, const std::string& description, Change change = kRuntime);
  /// A text that has to be something.
  void add(const std::string& name, std::string& member, const std::string& description, TextRule rule,
           Change change = kRuntime);

  /// One of a few, each with its name.
  template <class Enum>
  requires(std::is_enum_v<Enum> ||
           std::is_same_v<Enum, bool>) void add(const std::string& name, Enum& member, const std::string& description,
                                                const std::vector<std::pair<std::string, Enum>>& choices,
                                                Change change = kRuntime) {
    std::vector<std::string> names;
    std::string current;
    for (const auto& [text, value] : choices) {
      if (values_ != nullptr && std::get<std::string>(values_->at(name)) == text) member = value;
      if (value == member) current = text;
      names.push_back(text);
    }
    if (values_ == nullptr) declare({name, current, description, {}, std::move(names), change});
  }

 private:
  template <class T, class Value>
  static T scaled(const Value& value, double unit) {
    if constexpr (std::is_same_v<Value, double>) return static_cast<T>(value * unit);
    if constexpr (std::is_same_v<Value, std::int64_t>) return static_cast<T>(value * static_cast<std::int64_t>(unit));
    return T();
  }
  /// A default as somebody would write it: 0.2, not the nearest float's 0.200000003.
  static double as_written(float member, double unit);
  static double as_written(double member, double unit);
  void declare(ParameterSpec spec);

  std::vector<ParameterSpec>* specs_ = nullptr;
  const std::map<std::string, ParameterValue>* values_ = nullptr;
};

/// A service's parameters: declared once, set by `--set name=value` and by control/<service>. Thread-safe.
class Parameters {
 public:
  explicit Parameters(std::vector<ParameterSpec> specs = {});

  /// The specs of a struct with bind().
  template <class Options>
  [[nodiscard]] static std::vector<ParameterSpec> declare() {
    std::vector<ParameterSpec> specs;
    ParameterBinder binder(specs);
    Options().bind(binder);
    return specs;
  }

  /// The present values, all of one instant. Every parameter that it binds is declared.
  template <class Options>
  [[nodiscard]] Options read() const {
    const std::scoped_lock lock(mutex_);
    Options options;
    ParameterBinder binder(values_);
    options.bind(binder);
    return options;
  }

  /// Parses, checks and sets; booleans are true/false, 1/0, on/off or yes/no. Returns an empty string, or what was
  /// wrong, in words that name parameter and value, and the nearest parameter where there is none of that name.
  [[nodiscard]] std::string set(const std::string& name, const std::string& text, bool at_runtime);

  [[nodiscard]] std::uint64_t version() const;  ///< grows with every change
  [[nodiscard]] std::vector<std::pair<std::string, std::string>> list() const;
  [[nodiscard]] const std::vector<ParameterSpec>& specs() const { return specs_; }

 private:
  const std::vector<ParameterSpec> specs_;
  mutable std::mutex mutex_;
  std::map<std::string, ParameterValue> values_;
  std::uint64_t version_ = 0;
};

/// A service's own copy of its options, renewed when it says so. Not thread-safe; `parameters` outlive it.
template <class Options>
class LiveOptions {
 public:
  explicit LiveOptions(const Parameters& parameters) : parameters_(&parameters) { renew(); }

  /// Takes over what has changed since; false when nothing has.
  bool refresh() {
    if (parameters_->version() == version_) return false;
    renew();
    return true;
  }
  const Options& operator*() const { return options_; }
  const Options* operator->() const { return &options_; }

 private:
  void renew() {
    version_ = parameters_->version();
    options_ = parameters_->read<Options>();
  }

  const Parameters* parameters_;
  std::uint64_t version_ = 0;
  Options options_;
};

}  // namespace splatbus::bus
