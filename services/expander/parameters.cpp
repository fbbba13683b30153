#include "expander/parameters.h"

#include <cmath>

namespace splatbus::expander {

void Options::bind(bus::ParameterBinder& p) {
  using bus::kFixed;
  p.add("cell_size_m", cell_size_m, "edge of a grid cell, metres", {0.01, 100}, kFixed);
  p.add("reach_m", insert.select.reach_m, "samples nearer to a viewer are modelled however small they are, metres",
        {.minimum = 0});
  p.add("min_pixels", insert.select.min_pixels,
        "farther ones are modelled where their spacing is as many pixels of a viewer's picture", {.minimum = 0});
  p.add("ahead_s", ahead_s, "viewers count as where they will be in this time, too, seconds", {0, 60});
  p.add("min_samples", insert.select.min_samples,
        "a cell counts as seen with this many samples in it and in the cells beside it", {1, 10000});
  p.add("new_distance", insert.select.new_distance,
        "what is modelled nearer than this covers a sample, as a fraction of its spacing", {0, 10});
  p.add("fill_distance", insert.select.fill_distance,
        "the same in a cell that is being filled, where it is the smaller one", {0, 10});
  p.add("fill_steps_per_s", fill_steps_per_s,
        "optimizer steps a second from which on a cell is filled that densely; at fewer less so, down to new_distance",
        {0, 1e6});
  p.add("hole_distance", insert.select.hole_distance,
        "where nothing is modelled nearer than this there is a hole, as a fraction of a sample's spacing", {0, 10});
  p.add("refine_factor", insert.select.refine_factor,
        "a cell is filled again when its samples are finer than before by this factor", {1, 10});
  p.add("refine_share", insert.select.refine_share, "or when this share of them is not covered", {0, 1});
  p.add("initial_scale", insert.initial.scale,
        "standard deviation of a new Gaussian along the surface, as a fraction of its spacing", {0.01, 10});
  p.add("flatness", insert.initial.flatness,
        "standard deviation of a new Gaussian along its normal, as a fraction of that along the surface", {0.001, 1});
  p.add("initial_opacity", insert.initial.opacity, "opacity of a new Gaussian", {0.01, 0.999});
  p.add("batch_size", insert.batch_size, "most Gaussians of one model/insert", {1, 1 << 20});
  p.add("max_samples", max_samples, "most samples of an input round; larger ones are refused", {64, 8 << 20}, kFixed);
  p.add("max_cells", max_cells, "most cells that grid/state tells of", {1, 1 << 24}, kFixed);
  p.add("repeat_s", repeat_s, "grid/state tells of some cells that have not changed again this often, seconds",
        {.minimum = 0.001});
  p.add("max_gaussians", max_gaussians, "Gaussians beyond which nothing is inserted",
        {1, static_cast<double>(kGaussianLimit)});
  p.add("resend_s", resend_s, "a batch that is not acknowledged is repeated after this time, seconds",
        {.minimum = 0.01});
  p.add("adopt_wait_s", adopt_wait_s,
        "how long input waits for a trainer to say what it has before insertion begins regardless, seconds",
        {.minimum = 0});
  p.add("refresh_s", refresh_s,
        "before an insertion the points of a model that has changed are read again, at most this often, seconds",
        {.minimum = 0});
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
