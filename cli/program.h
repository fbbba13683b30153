#pragma once

#include <span>

#include "verbs.h"

namespace splatbus::cli {

using AddVerb = void (*)(CLI::App& app, Action& action);

/// The program splatbus with these verbs. Returns its exit status; errors go to stderr.
[[nodiscard]] int run_program(int argc, char** argv, std::span<const AddVerb> verbs);

}  // namespace splatbus::cli
