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

std::vector<ObjectFrame> frames_of(const ObjectTransforms& objects) {
  std::vector<ObjectFrame> frames;
  frames.reserve(objects.size());
  for (const auto& [id, world_from_object] : objects) {
    if (id != kWorldFrame) frames.push_back({id, inverse(portable(world_from_object))});
  }
  return frames;
}

}  // namespace

InsertBatch allocate_batch(device::StreamView stream, std::uint32_t count) {
  const auto memory = std::make_shared<device::Buffer<std::byte>>(stream, count * kInsertBytes);
  return {.count = count, .memory = stream.device, .data = {memory, memory->data()}};
}

GaussianInserter::GaussianInserter(Device device, float cell_size_m)
    : stream_(device::thread_stream(device)),
      modelled_(stream_, cell_size_m),
      adopted_(stream_, cell_size_m),
      selector_(stream_) {}

InsertResult GaussianInserter::insert(const Round& round, const InsertOptions& options) {
  InsertResult result;
  const std::uint32_t selected =
      selector_.select(round.samples, frames_of(round.scene.objects), modelled_, options.select);
  result.selected = selected;
  result.cells = selector_.cells();
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

void GaussianInserter::add(std::span<const InsertBatch* const> batches) {
  std::vector<InsertChannels> channels;
  channels.reserve(batches.size());
  for (const InsertBatch* batch : batches) channels.push_back(batch->channels());
  modelled_.add(channels);
}

bool GaussianInserter::adopt(const PublishedModel& model) {
  const GaussiansView& view = model.live();
  const IndexRange all{.first = 0, .count = static_cast<std::uint32_t>(view.count)};
  adopted_.assign({.surface_point = view.surface_point,
                   .normal = view.normal,
                   .object_id = view.object_id,
                   .stride = view.stride,
                   .page_shift = view.page_shift,
                   .page_stride = view.page_stride,
                   .ranges = view.has_pages() ? view.ranges : std::span(&all, 1)});
  host_bytes_ += model.copied_bytes();
  if (!model.still_valid()) return false;
  std::swap(modelled_, adopted_);
  return true;
}

}  // namespace splatbus::expander
