#include "expander/parameters.h"

#include <cmath>

namespace splatbus::expander {

void Options::bind(bus::ParameterBinder& p) {
  using bus::kFixed;
  p.add("cell_size_m", cell_size_m, "edge of a grid cell, m", {0.01, 100}, kFixed);
  p.add("reach_m", insert.select.reach_m, "distance from a viewer within which every sample is modelled, m",
        {.minimum = 0});
  p.add("min_pixels", insert.select.min_pixels,
        "spacing in a viewer's picture from which farther samples are modelled, pixels", {.minimum = 0});
  p.add("ahead_s", ahead_s, "time ahead at which viewers count too, s", {0, 60});
  p.add("min_samples", insert.select.min_samples,
        "samples in a cell and its neighbours that make the cell count as seen", {1, 10000});
  p.add("new_distance", insert.select.new_distance,
        "distance to the nearest Gaussian below which a sample is covered, in sample spacings", {0, 10});
  p.add("fill_distance", insert.select.fill_distance,
        "the same limit in a cell that is being filled; the smaller one counts", {0, 10});
  p.add("fill_steps_per_s", fill_steps_per_s,
        "optimizer steps per second from which cells are filled up to fill_distance; fewer steps fill less", {0, 1e6});
  p.add("hole_distance", insert.select.hole_distance,
        "distance to the nearest Gaussian above which there is a hole, in sample spacings", {0, 10});
  p.add("refine_factor", insert.select.refine_factor,
        "factor by which samples have to be finer than before for a cell to be filled again", {1, 10});
  p.add("refine_share", insert.select.refine_share, "share of uncovered samples from which a cell is filled again",
        {0, 1});
  p.add("initial_scale", insert.initial.scale,
        "standard deviation of a new Gaussian along the surface, in sample spacings", {0.01, 10});
  p.add("flatness", insert.initial.flatness,
        "standard deviation of a new Gaussian along its normal, relative to that along the surface", {0.001, 1});
  p.add("initial_opacity", insert.initial.opacity, "opacity of a new Gaussian", {0.01, 0.999});
  p.add("batch_size", insert.batch_size, "most Gaussians in one model/insert message", {1, 1 << 20});
  p.add("max_samples", max_samples, "most samples in an input round; larger rounds are refused", {64, 8 << 20}, kFixed);
  p.add("max_cells", max_cells, "most cells in grid/state", {1, 1 << 24}, kFixed);
  p.add("repeat_s", repeat_s, "time after which grid/state repeats some unchanged cells, s", {.minimum = 0.001});
  p.add("max_gaussians", max_gaussians, "most Gaussians in the model; nothing is inserted beyond",
        {1, static_cast<double>(kGaussianLimit)});
  p.add("resend_s", resend_s, "time after which an unacknowledged batch is sent again, s", {.minimum = 0.01});
  p.add("adopt_wait_s", adopt_wait_s, "longest wait for a trainer to say what it has before insertion begins, s",
        {.minimum = 0});
  p.add("refresh_s", refresh_s, "least time between two readings of the points of a changed model, s", {.minimum = 0});
  p.add("kept_mb", queue.kept_bytes, "acknowledged batches kept for a trainer that loses its model, MiB", {0, 1 << 20},
        kFixed, bus::kMebibytes);
  queue.resend_ns = static_cast<std::int64_t>(resend_s * 1e9);
}

InsertOptions Options::insert_at(double steps_per_s) const {
  InsertOptions at = insert;
  if (steps_per_s > 0 && steps_per_s < fill_steps_per_s) {
    at.select.fill_distance *= static_cast<float>(std::sqrt(fill_steps_per_s / steps_per_s));
  }
  return at;
}

}  // namespace splatbus::expander
