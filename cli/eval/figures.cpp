#include "figures.h"

#include <fmt/format.h>

#include <algorithm>
#include <cassert>
#include <cmath>
#include <fstream>
#include <iterator>
#include <stdexcept>
#include <string>

namespace splatbus::cli {

namespace {

constexpr double kHighestPsnr = 100;

}  // namespace

FigureSummary summarize(const ViewFigures& figures) {
  assert(!figures.empty());
  FigureSummary summary;
  summary.ssim_min = figures.begin()->second.ssim;
  for (const auto& [view, quality] : figures) {
    summary.mean.ssim += quality.ssim;
    summary.mean.psnr_db += finite_psnr(quality.psnr_db);
    summary.mean.flip += quality.flip;
    summary.ssim_min = std::min(summary.ssim_min, quality.ssim);
    summary.flip_max = std::max(summary.flip_max, quality.flip);
  }
  const auto count = static_cast<double>(figures.size());
  summary.mean.ssim /= count;
  summary.mean.psnr_db /= count;
  summary.mean.flip /= count;
  return summary;
}

ViewFigures last_round(const ViewFigures& figures_of_probes) {
  constexpr std::size_t kMostLost = 16;  // rounds are hundreds apart
  const auto end = figures_of_probes.end();
  auto first = end;
  while (first != figures_of_probes.begin() && (first == end || first->first - std::prev(first)->first <= kMostLost)) {
    --first;
  }
  return {first, end};
}

std::string csv_rows(std::uint64_t iteration, double optimizer_s, const ViewFigures& figures) {
  std::string rows;
  for (const auto& [view, quality] : figures) {
    rows += fmt::format("{},{},{:.5f},{:.3f},{:.5f},{:.4f}\n", iteration, view, quality.ssim,
                        finite_psnr(quality.psnr_db), quality.flip, optimizer_s);
  }
  return rows;
}

void write_text(const std::string& path, const std::string& text) {
  std::ofstream file(path);
  if (!(file << text) || !file.flush()) throw std::runtime_error(path + ": cannot be written");
}

double finite_psnr(double psnr_db) {
  return std::min(psnr_db, kHighestPsnr);
}

double rounded(double value) {
  return std::isfinite(value) ? std::stod(fmt::format("{:.6g}", value)) : 0.0;
}

}  // namespace splatbus::cli
