#pragma once

namespace splatbus::trainer {

/// How much smaller than a Gaussian the two are into which it is split (Kerbl et al. 2023).
constexpr float kSplitFactor = 1.6F;

}  // namespace splatbus::trainer
