#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace splatbus::bus {

/// The known name that somebody who typed `word` most likely meant: the fewest letters left out, put in, changed or
/// swapped with their neighbour, at most a third of the longer of both; case counts for nothing. Empty when none is
/// that near.
[[nodiscard]] std::string nearest(std::string_view word, const std::vector<std::string>& known);

/// "; did you mean 'trainer'?", or " (known: a, b)" where no name is near; empty when nothing is known.
[[nodiscard]] std::string suggestion(std::string_view word, const std::vector<std::string>& known);

}  // namespace splatbus::bus
