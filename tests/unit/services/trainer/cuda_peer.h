#pragma once

#include <cstddef>
#include <string>

namespace splatbus::trainer {

inline constexpr std::size_t peer_max_gaussians = 20000;

/// A trainer with its model in device memory, on the bus in a folder, that says "ready" and is killed. "--hold": it has
/// 2700 Gaussians and 7 steps; "--churn": it adds and removes without end.
int run_peer(const std::string& role, const std::string& folder);

}  // namespace splatbus::trainer
