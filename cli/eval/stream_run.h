#pragma once

#include <functional>
#include <string>

#include "stream_figures.h"
#include "stream_plan.h"
#include "supervised_run.h"

namespace splatbus::cli {

/// The pipeline, a viewer behind a link, and those that only follow beside it; at the end another viewer that joins.
/// The log of the services is named after `name` in the setup's `out`. Throws std::runtime_error.
[[nodiscard]] StreamResults run_stream(const StreamRunOptions& options, const std::string& name,
                                       const StopSignals& signals,
                                       const std::function<void(const std::string&)>& show_state);

}  // namespace splatbus::cli
