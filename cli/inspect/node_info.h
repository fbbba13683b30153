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

}  // namespace splatbus::cli
