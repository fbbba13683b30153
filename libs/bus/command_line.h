#pragma once

#include <optional>

// Declared here only: its header takes seconds to compile.
namespace CLI {
class App;
}

namespace splatbus::bus {

/// Exit statuses of every program: 0, 1 (it failed, which may pass), 2 (it was started wrongly, and starting it again
/// with the same arguments fails again).
inline constexpr int kExitFailed = 1;
inline constexpr int kExitUsage = 2;

/// Whether a supervisor started this program: then it ends with 128 + the signal that stopped it. The supervisor knows
/// what it asked for itself; what somebody else stopped it starts again.
[[nodiscard]] bool is_supervised();
/// Exit status of a program that ends as it should, because of that signal (0: of itself).
[[nodiscard]] int exit_status_after(int signal);

/// Parses. Nullopt when the program may run; else its exit status: 0 after --help or --version, and kExitUsage after a
/// message on stderr that begins with the program's name, and suggests the nearest verb or option to a mistyped one.
[[nodiscard]] std::optional<int> parse_command_line(CLI::App& app, int argc, const char* const* argv);

}  // namespace splatbus::bus
