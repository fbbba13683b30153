#pragma once

#include <algorithm>
#include <string>
#include <string_view>
#include <vector>

namespace splatbus::cli {

/// Whether one of `patterns` is the topic, or ends in '*' and is what it begins with.
[[nodiscard]] inline bool matches_any(const std::vector<std::string>& patterns, std::string_view topic) {
  return std::ranges::any_of(patterns, [&](std::string_view pattern) {
    if (pattern.ends_with('*')) return topic.starts_with(pattern.substr(0, pattern.size() - 1));
    return topic == pattern;
  });
}

}  // namespace splatbus::cli
