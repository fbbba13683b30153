#pragma once

#include <cstddef>

namespace splatbus {

/// How many Gaussians a model has in memory unless somebody says otherwise, which is what a streamer serves, and how
/// many any model may have.
inline constexpr std::size_t kDefaultMaxGaussians = 4'000'000;
inline constexpr std::size_t kGaussianLimit = 31'000'000;  // whose page table one message can name

}  // namespace splatbus
