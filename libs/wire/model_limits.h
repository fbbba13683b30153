#pragma once

#include <cstddef>

namespace splatbus {

/// How many Gaussians a model holds unless somebody says otherwise, nearly all that a streamer serves, and how many any
/// may hold.
inline constexpr std::size_t kDefaultMaxGaussians = 4'000'000;
inline constexpr std::size_t kGaussianLimit = 31'000'000;  // whose page table one message can name

}  // namespace splatbus
