#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "dynamics_figures.h"
#include "explore_run.h"

namespace splatbus::cli {

/// Bytes of device memory beside those of frozen pages; nullopt where the trainer does not say.
[[nodiscard]] std::optional<double> active_mb(const ExploreSample& sample);
/// Optimizer time of a step within a window of the walk; nullopt where there was none.
[[nodiscard]] std::optional<double> step_ms(const ExploreResults& results, const TimeWindow& window);

/// A line a sample; what was not measured is empty.
[[nodiscard]] std::string exploration_csv(const ExploreResults& results);
/// Gaussians, pages, memory, times, SSIM and FLIP, and what nothing modelled, over time.
void write_exploration_plots(const ExploreResults& results, const std::filesystem::path& path);
/// Some instants of `results`: the engine's picture from where the first viewer was, and the viewer's own.
void write_exploration_sheet(const ExploreResults& results, const std::vector<ExplorePictures>& chosen,
                             const std::string& title, const std::filesystem::path& path);

}  // namespace splatbus::cli
