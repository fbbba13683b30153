#pragma once

#include <cstddef>

namespace splatbus {

/// How many Gaussians a model holds unless somebody says otherwise, and how many any may hold.
inline constexpr std::size_t kDefaultMaxGaussians = 2'000'000;
inline constexpr std::size_t kGaussianLimit = 31'000'000;  // whose page table one message can name

}  // namespace splatbus
