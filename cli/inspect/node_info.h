#pragma once

#include <string>

#include "bus_watch.h"

namespace splatbus::cli {

struct NodeInfoOptions {
  std::string bus, name;
  bool json = false;
};

/// The source of that name, or the only one of that kind. Throws std::runtime_error that says what there is.
[[nodiscard]] std::string find_node(const std::map<std::string, NodeState>& nodes, const std::string& name);

/// `splatbus node info`. Returns the exit status.
int node_info(const NodeInfoOptions& options);

/// "3 min 2 s"
[[nodiscard]] std::string duration_text(double seconds);
/// "512.3 MiB"
[[nodiscard]] std::string bytes_text(double bytes);

}  // namespace splatbus::cli
