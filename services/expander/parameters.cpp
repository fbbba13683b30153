#include "expander/parameters.h"

namespace splatbus::expander {

void Options::bind(bus::ParameterBinder& p) {
  using bus::kFixed;
  using bus::kRuntime;
  p.add("cell_size_m", mapper.cell_size_m, "edge of a grid cell, metres", {0.01, 100}, kFixed);
  p.add("candidate_radius_m", grow.grid.candidate_radius_m,
        "samples farther from the viewer are left for later, metres", {.minimum = 0.1});
  p.add("min_samples", grow.grid.min_samples,
        "a cell counts as seen with this many samples in it or in a cell beside it", {1, 10000});
  p.add("min_cosine", grow.visibility.min_cosine,
        "a sample counts as seen at this cosine between its normal and the direction to its camera", {0, 1});
  p.add("depth_tolerance", grow.visibility.depth_tolerance,
        "a sample's depth matches its camera's depth map within this fraction", {1e-4, 1});
  p.add("new_distance", grow.grid.new_distance,
        "samples of new cells keep this distance from what is modelled, as a fraction of their spacing", {0, 10});
  p.add("top_up_distance", grow.grid.top_up_distance,
        "samples of modelled cells keep this distance from what is modelled, as a fraction of their spacing", {0, 10});
  p.add("top_up_fraction", grow.grid.top_up_fraction,
        "a modelled cell is topped up when this share of what it holds is new", {0, 10});
  p.add("initial_scale", grow.initial.scale,
        "standard deviation of a new Gaussian along the surface, as a fraction of its spacing", {0.01, 10});
  p.add("flatness", grow.initial.flatness,
        "standard deviation of a new Gaussian along its normal, as a fraction of that along the surface", {0.001, 1});
  p.add("initial_opacity", grow.initial.opacity, "opacity of a new Gaussian", {0.01, 0.999});
  p.add("batch_size", grow.batch_size, "most Gaussians of one model/insert", {1, 1 << 20});
  p.add("max_gaussians", max_gaussians, "Gaussians beyond which nothing is inserted",
        {1, static_cast<double>(kGaussianLimit)});
  p.add("resend_s", resend_s, "a batch that is not acknowledged is repeated after this time, seconds",
        {.minimum = 0.01});
  p.add("adopt_wait_s", adopt_wait_s,
        "how long input waits for a trainer to say what it has before insertion begins regardless, seconds",
        {.minimum = 0});
  p.add("retry_s", retry_s, "what there was no memory for is tried again after this time, seconds", {.minimum = 0.001});
  p.add("device_mb", device_bytes,
        "most device memory for rounds, batches and the grid, what usual_samples take included, beside slabs, MiB; "
        "0: as much as the device has",
        {0, 1 << 20}, kRuntime, bus::kMebibytes);
  p.add("usual_samples", mapper.usual_samples, "a device has memory ready for rounds of this many samples",
        {64, 8 << 20}, kFixed);
  p.add("kept_mb", ledger.kept_bytes, "acknowledged batches kept for a trainer that loses its model, MiB", {0, 1 << 20},
        kFixed, bus::kMebibytes);
  grow.grid.cell_size_m = mapper.cell_size_m;
  ledger.resend_ns = static_cast<std::int64_t>(resend_s * 1e9);
  if (device_bytes == 0) device_bytes = SIZE_MAX;
}

}  // namespace splatbus::expander
