#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>

#include "metrics/metrics.h"

namespace splatbus::cli {

/// Figures of some views, by view.
using ViewFigures = std::map<std::size_t, metrics::Quality>;

struct FigureSummary {
  metrics::Quality mean;
  double ssim_min = 0, flip_max = 0;
};

/// Of at least one view.
[[nodiscard]] FigureSummary summarize(const ViewFigures& figures);

/// By probe ids: those of the last round (ProbeRounds). Its ids follow one another, but for a few that were lost.
[[nodiscard]] ViewFigures last_round(const ViewFigures& figures_of_probes);

/// Lines of one iteration under kCsvHeader; `optimizer_s` is what training has taken so far.
[[nodiscard]] std::string csv_rows(std::uint64_t iteration, double optimizer_s, const ViewFigures& figures);
inline constexpr const char* kCsvHeader = "iteration,view,ssim,psnr,flip,optimizer_s\n";

/// Writes text to a file; throws std::runtime_error that names it.
void write_text(const std::string& path, const std::string& text);

/// An infinite PSNR (equal pictures) counts as 100 dB, so that means stay finite.
[[nodiscard]] double finite_psnr(double psnr_db);

/// Six significant digits: what a figure in a summary is worth.
[[nodiscard]] double rounded(double value);

}  // namespace splatbus::cli
