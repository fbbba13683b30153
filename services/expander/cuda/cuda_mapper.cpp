#include "expander/cuda/cuda_mapper.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "device/check.h"
#include "gaussians/sh.h"

namespace splatbus::expander::cuda {

namespace {

using device::check;

constexpr std::size_t kBatchAlignment = 256;

float3 on_device(const glm::vec3& v) {
  return {v.x, v.y, v.z};
}

void download(void* host, const void* from, std::size_t bytes) {
  check(cudaMemcpyAsync(host, from, bytes, cudaMemcpyDeviceToHost, thread_stream()), "reading a result");
}

void wait() {
  check(cudaStreamSynchronize(thread_stream()), "waiting for the device");
}

/// ambient_reflected() as coefficients of products of the normal's components.
void set_ambient(const Light& light, InitialValues& values) {
  const std::array<float, 9> factors = {kShC0,        -kShC1 * 2 / 3, kShC1 * 2 / 3, -kShC1 * 2 / 3, kShC2[0] / 4,
                                        kShC2[1] / 4, kShC2[2] / 4,   kShC2[3] / 4,  kShC2[4] / 4};
  for (std::size_t k = 0; k < factors.size(); ++k) values.ambient[k] = on_device(factors[k] * light.ambient_sh[k]);
}

InitialValues initial_values(const InitialOptions& options, const Light& light) {
  InitialValues values{.scale = options.scale,
                       .log_flatness = std::log(options.flatness),
                       .opacity_logit = std::log(options.opacity / (1 - options.opacity)),
                       .least_spacing_m = kLeastSpacing_m,
                       .least_sun_part = kLeastSunPart,
                       .ambient = {},
                       .sun_direction = on_device(light.sun_direction),
                       .sun_irradiance = on_device(light.sun_irradiance)};
  set_ambient(light, values);
  return values;
}

}  // namespace

CudaMapper::CudaMapper(const MapperOptions& options)
    : cell_size_m_(options.cell_size_m), modelled_(pool_), workspace_(pool_), counts_(1) {
  warm_up(options.usual_samples);
}

std::unique_ptr<Round> CudaMapper::take(const IncomingRound& round) {
  return DeviceRound::take(round, pool_, host_bytes_);
}

Growth CudaMapper::grow(const Round& round, const GrowOptions& options) {
  const auto& samples = static_cast<const DeviceRound&>(round);
  if (samples.view().count == 0) return {};
  // All that takes memory comes before anything is remembered as modelled.
  const Counts counts = choose(samples.view(), options);
  fetch_rows(counts.cells);
  const auto room = static_cast<std::uint32_t>(std::min<std::size_t>(options.room, UINT32_MAX));
  const std::uint32_t chosen = std::min(counts.chosen, room);
  modelled_.reserve(chosen, thread_stream());
  Growth growth{.unseen = counts.unseen, .chosen = chosen, .batches = make_batches(samples, chosen, options)};
  for (const InsertBatch& batch : growth.batches) {
    modelled_.append(batch.planes(), static_cast<std::uint32_t>(batch.size()), thread_stream());
  }
  wait();
  note_rows(counts.cells);
  return growth;
}

CudaMapper::Counts CudaMapper::choose(const RoundView& round, const GrowOptions& options) {
  cudaStream_t stream = thread_stream();
  workspace_.resize(round.count);
  const Placement placement = workspace_.placement();
  const ChoiceView choice = workspace_.choice();
  launch_survey(round,
                {.viewer = on_device(options.viewer),
                 .candidate_radius_m = options.grid.candidate_radius_m,
                 .cell_size_m = cell_size_m_,
                 .min_cosine = options.visibility.min_cosine,
                 .depth_tolerance = options.visibility.depth_tolerance},
                placement, workspace_.unseen(), stream);
  workspace_.cells.build(placement.key, round.count, stream);
  const CellTableView cells = workspace_.cells.view();
  launch_choose(round, placement, cells, modelled_.view(stream),
                {.cell_size_m = cell_size_m_,
                 .new_distance = options.grid.new_distance,
                 .top_up_distance = options.grid.top_up_distance,
                 .top_up_fraction = options.grid.top_up_fraction,
                 .same_surface_cosine = kSameSurfaceCosine,
                 .min_samples = static_cast<std::uint32_t>(std::max(options.grid.min_samples, 0)),
                 .room = static_cast<std::uint32_t>(std::min<std::size_t>(options.room, UINT32_MAX))},
                choice, workspace_.scratch(), workspace_.scratch_bytes(), stream);
  download(&counts_[0].unseen, workspace_.unseen(), sizeof(std::uint32_t));
  download(&counts_[0].chosen, choice.count, sizeof(std::uint32_t));
  download(&counts_[0].cells, cells.cells, sizeof(std::uint32_t));
  wait();
  return counts_[0];
}

std::vector<InsertBatch> CudaMapper::make_batches(const DeviceRound& round, std::uint32_t count,
                                                  const GrowOptions& options) {
  if (count == 0) return {};
  const std::size_t batch_size = std::min<std::size_t>(options.batch_size, count);
  const std::size_t stride = (batch_size * kInsertBytes + kBatchAlignment - 1) / kBatchAlignment * kBatchAlignment;
  const std::size_t batches = (count + batch_size - 1) / batch_size;
  const std::shared_ptr<std::byte> memory = pool_.take(batches * stride, "the new Gaussians of a round");
  launch_gaussians(round.view(), workspace_.placement(), workspace_.choice().chosen,
                   initial_values(options.initial, round.info().light),
                   {.data = memory.get(),
                    .count = count,
                    .batch_size = static_cast<std::uint32_t>(batch_size),
                    .batch_stride = stride},
                   thread_stream());
  std::vector<InsertBatch> made(batches);
  for (std::size_t b = 0; b < batches; ++b) {
    made[b] = {.capture_ns = round.info().capture_ns,
               .objects = round.info().objects,
               .light = round.info().light,
               .count = std::min(batch_size, count - b * batch_size),
               .memory = Device::Cuda,
               .data = {memory, memory.get() + b * stride}};
  }
  return made;
}

void CudaMapper::fetch_rows(std::uint32_t cells) {
  const std::size_t room = std::size_t{cells} + 1;
  row_cell_.resize(room);
  row_start_.resize(room);
  row_inserted_.resize(room);
  if (cells == 0) return;
  const CellTableView table = workspace_.cells.view();
  download(row_cell_.data(), table.id, cells * sizeof(std::uint64_t));
  download(row_start_.data(), table.start, room * sizeof(std::uint32_t));
  download(row_inserted_.data(), workspace_.choice().inserted, cells * sizeof(std::uint32_t));
}

void CudaMapper::note_rows(std::uint32_t cells) {
  for (std::uint32_t i = 0; i < cells; ++i) {
    CellRow& row = rows_[row_cell_[i]];
    row.samples = row_start_[i + 1] - row_start_[i];
    row.points += row_inserted_[i];
  }
}

void CudaMapper::add(const InsertBatch& batch) {
  modelled_.append(batch.planes(), static_cast<std::uint32_t>(batch.size()), thread_stream());
  points_stale_ = true;
}

bool CudaMapper::holds_any(const InsertBatch& batch) {
  std::uint32_t* const found = workspace_.unseen();
  launch_find_exact(batch.planes(), static_cast<std::uint32_t>(batch.size()), modelled_.view(thread_stream()), found,
                    thread_stream());
  download(&counts_[0].unseen, found, sizeof(std::uint32_t));
  wait();
  return counts_[0].unseen != 0;
}

bool CudaMapper::adopt(const PublishedModel& model) {
  const GaussiansView& view = model.live();
  ModelledPoints points(pool_);
  points.append({.position = view.surface_point,
                 .normal = view.normal,
                 .object_id = view.object_id,
                 .cell = view.cell,
                 .stride = view.stride},
                static_cast<std::uint32_t>(view.count), cell_size_m_, thread_stream());
  host_bytes_ += model.copied_bytes();
  if (!model.still_valid()) return false;
  clear();
  modelled_ = std::move(points);
  points_stale_ = true;
  return true;
}

void CudaMapper::clear() {
  modelled_.clear();
  rows_.clear();
  points_stale_ = false;
}

void CudaMapper::refresh_points() {
  if (!points_stale_) return;
  const auto cells = modelled_.cells(thread_stream());
  for (auto& [cell, row] : rows_) row.points = 0;
  for (const auto& [cell, points] : cells) rows_[cell].points = points;
  points_stale_ = false;
}

std::vector<CellCounts> CudaMapper::cells() {
  refresh_points();
  std::vector<CellCounts> counts;
  counts.reserve(rows_.size());
  for (const auto& [cell, row] : rows_) counts.push_back({.cell = cell, .samples = row.samples, .points = row.points});
  return counts;
}

std::size_t CudaMapper::cell_count() {
  refresh_points();
  return rows_.size();
}

}  // namespace splatbus::expander::cuda
