#include "expander/parameters.h"

namespace splatbus::expander {

std::vector<bus::ParameterSpec> parameter_specs() {
  return {
      {.name = "cell_size_m",
       .default_value = 0.25,
       .description = "edge of a grid cell, metres",
       .minimum = 0.01,
       .maximum = 100,
       .runtime = false},
      {.name = "candidate_radius_m",
       .default_value = 12.0,
       .description = "samples farther from the viewer are left for later, metres",
       .minimum = 0.1},
      {.name = "min_samples",
       .default_value = std::int64_t{4},
       .description = "a cell counts as seen with this many samples in it or in a cell beside it",
       .minimum = 1,
       .maximum = 10000},
      {.name = "min_cosine",
       .default_value = 0.15,
       .description = "a sample counts as seen at this cosine between its normal and the direction to its camera",
       .minimum = 0,
       .maximum = 1},
      {.name = "depth_tolerance",
       .default_value = 0.02,
       .description = "a sample's depth matches its camera's depth map within this fraction",
       .minimum = 1e-4,
       .maximum = 1},
      {.name = "new_distance",
       .default_value = 0.5,
       .description = "samples of new cells keep this distance from what is modelled, as a fraction of their spacing",
       .minimum = 0,
       .maximum = 10},
      {.name = "top_up_distance",
       .default_value = 0.75,
       .description =
           "samples of modelled cells keep this distance from what is modelled, as a fraction of their spacing",
       .minimum = 0,
       .maximum = 10},
      {.name = "top_up_fraction",
       .default_value = 0.02,
       .description = "a modelled cell is topped up when this share of what it holds is new",
       .minimum = 0,
       .maximum = 10},
      {.name = "initial_scale",
       .default_value = 0.42,
       .description = "standard deviation of a new Gaussian along the surface, as a fraction of its spacing",
       .minimum = 0.01,
       .maximum = 10},
      {.name = "flatness",
       .default_value = 0.2,
       .description = "standard deviation of a new Gaussian along its normal, as a fraction of that along the surface",
       .minimum = 0.001,
       .maximum = 1},
      {.name = "initial_opacity",
       .default_value = 0.95,
       .description = "opacity of a new Gaussian",
       .minimum = 0.01,
       .maximum = 0.999},
      {.name = "batch_size",
       .default_value = std::int64_t{65536},
       .description = "most Gaussians of one model/insert",
       .minimum = 1,
       .maximum = 1 << 20},
      {.name = "max_gaussians",
       .default_value = std::int64_t{2'000'000},
       .description = "nothing is inserted beyond this many Gaussians",
       .minimum = 1},
      {.name = "resend_s",
       .default_value = 1.0,
       .description = "a batch that is not acknowledged is repeated after this time, seconds",
       .minimum = 0.01},
      {.name = "adopt_wait_s",
       .default_value = 3.0,
       .description =
           "how long input waits for a trainer to say what it has before insertion begins regardless, seconds",
       .minimum = 0},
      {.name = "retry_s",
       .default_value = 1.0,
       .description = "what there was no memory for is tried again after this time, seconds",
       .minimum = 0.001},
      {.name = "device_mb",
       .default_value = std::int64_t{0},
       .description =
           "most device memory for rounds, batches and the grid, what usual_samples take included, beside slabs, MiB; "
           "0: as much as the device has",
       .minimum = 0,
       .maximum = 1 << 20},
      {.name = "usual_samples",
       .default_value = std::int64_t{1 << 20},
       .description = "a device has memory ready for rounds of this many samples",
       .minimum = 64,
       .maximum = 8 << 20,
       .runtime = false},
      {.name = "kept_mb",
       .default_value = std::int64_t{256},
       .description = "acknowledged batches kept for a trainer that loses its model, MiB",
       .minimum = 0,
       .maximum = 1 << 20,
       .runtime = false},
  };
}

GridOptions grid_options(const bus::Parameters& parameters) {
  const auto number = [&](const char* name) { return static_cast<float>(parameters.number(name)); };
  return {.cell_size_m = number("cell_size_m"),
          .candidate_radius_m = number("candidate_radius_m"),
          .min_samples = static_cast<int>(parameters.integer("min_samples")),
          .new_distance = number("new_distance"),
          .top_up_distance = number("top_up_distance"),
          .top_up_fraction = number("top_up_fraction")};
}

VisibilityOptions visibility_options(const bus::Parameters& parameters) {
  return {.min_cosine = static_cast<float>(parameters.number("min_cosine")),
          .depth_tolerance = static_cast<float>(parameters.number("depth_tolerance"))};
}

InitialOptions initial_options(const bus::Parameters& parameters) {
  return {.scale = static_cast<float>(parameters.number("initial_scale")),
          .flatness = static_cast<float>(parameters.number("flatness")),
          .opacity = static_cast<float>(parameters.number("initial_opacity"))};
}

MapperOptions mapper_options(const bus::Parameters& parameters) {
  return {.cell_size_m = static_cast<float>(parameters.number("cell_size_m")),
          .usual_samples = static_cast<std::uint32_t>(parameters.integer("usual_samples"))};
}

std::size_t device_bytes(const bus::Parameters& parameters) {
  const auto mebibytes = static_cast<std::size_t>(parameters.integer("device_mb"));
  return mebibytes == 0 ? SIZE_MAX : mebibytes << 20U;
}

BatchLedger::Options ledger_options(const bus::Parameters& parameters) {
  return {.resend_ns = static_cast<std::int64_t>(parameters.number("resend_s") * 1e9),
          .kept_bytes = static_cast<std::size_t>(parameters.integer("kept_mb")) << 20U};
}

}  // namespace splatbus::expander
