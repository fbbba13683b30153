#pragma once

#include <cstdint>

namespace splatbus {

// What tests count their time in.
inline constexpr std::int64_t kMs = 1'000'000, kSecond = 1'000 * kMs;

}  // namespace splatbus
