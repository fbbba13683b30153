#pragma once

#include "verbs.h"

namespace splatbus::cli {

/// `eval replay`: a model made anew from a recording, by a launch file's expander, trainer and relight on a bus of
/// their own, against the engine's pictures of held-out cameras that are in the recording.
void add_replay_verb(CLI::App& eval, Action& action);

}  // namespace splatbus::cli
