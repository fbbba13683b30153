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

/// Adds those flags, and --backend, to the command line. As it is parsed the settings of those that are given are
/// appended to `settings`, which is no list of --set's own: that one is emptied by what is parsed, and goes before.
/// `backend` becomes what --backend or SPLATBUS_BACKEND says of a device, whatever of its shorthands is given besides.
/// All of these stay as long as the command line is parsed.
void add_backend_and_shorthands(CLI::App& app, const std::vector<Shorthand>& flags, std::string& backend,
                                std::vector<std::string>& settings);

}  // namespace splatbus::bus
