#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

namespace splatbus::cli {

/// Names that stand for something else once a process is started, and not before.
[[nodiscard]] const std::vector<std::string>& process_variables();

/// Looks a name up: what it stands for, or nullopt to leave `${name}` as it is.
using Lookup = std::function<std::optional<std::string>(const std::string& name)>;

/// Replaces each `${name}` by what `lookup` says, without looking into that again. `$${` is left as it is: unescaped()
/// makes `${` of it in the end. Throws std::invalid_argument where a `${` has no end, or the text exceeds 64 KiB.
[[nodiscard]] std::string substitute(const std::string& text, const Lookup& lookup);

/// Text that stands for itself: `${` is written `$${`.
[[nodiscard]] std::string escaped(const std::string& text);
[[nodiscard]] std::string unescaped(const std::string& text);

}  // namespace splatbus::cli
