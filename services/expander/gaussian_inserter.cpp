#include "expander/gaussian_inserter.h"

#include <algorithm>
#include <array>
#include <utility>

#include "gaussians/portable.h"
#include "gaussians/sh.h"

namespace splatbus::expander {

namespace {

/// ambient_reflected() as coefficients of products of the normal's components.
LightTerms terms_of(const Light& light) {
  constexpr std::array<float, 9> kFactors = {kShC0,        -kShC1 * 2 / 3, kShC1 * 2 / 3, -kShC1 * 2 / 3, kShC2[0] / 4,
                                             kShC2[1] / 4, kShC2[2] / 4,   kShC2[3] / 4,  kShC2[4] / 4};
  LightTerms terms{{}, portable(light.sun_direction), portable(light.sun_irradiance)};
  for (std::size_t k = 0; k < kFactors.size(); ++k) terms.ambient[k] = portable(kFactors[k] * light.ambient_sh[k]);
  return terms;
}

}  // namespace

GaussianInserter::GaussianInserter(Device device, float cell_size_m, std::size_t max_cells)
    : stream_(device::thread_stream(device)),
      cells_(max_cells),
      modelled_(stream_, cell_size_m, cells_),
      selector_(stream_, cell_size_m) {}

InsertResult GaussianInserter::insert(const Round& round, std::span<const Viewpoint> viewpoints,
                                      const InsertOptions& options) {
  InsertResult result;
  const std::vector<ObjectFrame> objects = frames_of(round.scene.objects);
  selector_.bin(round.samples, objects, viewpoints, options.select);
  const std::uint32_t selected =
      selector_.select(round.samples, modelled_.near(selector_.search_cells(), objects), filled_, options.select);
  result.selected = selected;
  result.reasons = selector_.reasons();
  result.beyond = selector_.beyond();
  result.cells = selector_.cells();
  cells_.set_samples(result.cells);
  const LightTerms light = terms_of(round.scene.light);
  const auto batch_size = static_cast<std::uint32_t>(std::min<std::size_t>(options.batch_size, UINT32_MAX));
  for (std::uint32_t first = 0; first < selected; first += std::min(batch_size, selected - first)) {
    InsertBatch batch = allocate_batch(stream_, std::min(batch_size, selected - first));
    batch.capture_ns = round.capture_ns;
    batch.scene = round.scene;
    selector_.write(round.samples, first, options.initial, light, batch.channels());
    if (!stream_.on_cuda()) host_bytes_ += batch.bytes();
    result.batches.push_back(std::move(batch));
  }
  std::vector<const InsertBatch*> batches;
  for (const InsertBatch& batch : result.batches) batches.push_back(&batch);
  add(batches);
  stream_.wait();
  return result;
}

bool GaussianInserter::adopt(const PublishedModel& model, std::uint64_t trainer_epoch) {
  host_bytes_ += model.copied_bytes();
  return modelled_.read(model, trainer_epoch);
}

}  // namespace splatbus::expander
