#pragma once

#include <string>
#include <vector>

// Declared here only: its header takes seconds to compile.
namespace CLI {
class App;
}

namespace splatbus::bus {

/// A flag of a program that is short for --set.
struct Shorthand {
  std::string flag;     ///< "--window"; with a backend's name, "--backend gl", a value more that --backend takes
  std::string setting;  ///< "window=true"; where it ends with "=", what follows the flag is the value
  std::string help;
};

/// Adds those flags to the command line; what is given of them is appended to `changes` as it is parsed. --backend is
/// added too, with SPLATBUS_BACKEND for its default: one of its shorthands leaves `backend` at auto. All stay as long
/// as the command line is parsed.
void add_backend_and_shorthands(CLI::App& app, const std::vector<Shorthand>& flags, std::string& backend,
                                std::vector<std::string>& changes);

}  // namespace splatbus::bus
