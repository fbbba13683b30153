#include <cassert>
#include <memory>
#include <vector>

#include "expander/cuda/cuda_mapper.h"

namespace splatbus::expander::cuda {

namespace {

constexpr std::size_t kUsualCells = 1U << 16U;
constexpr std::size_t kFewGaussians = 4096;

template <class T>
bus::TensorView tensor_of(std::vector<std::uint32_t> shape, bus::ElementType type, std::vector<T> values) {
  const auto held = std::make_shared<std::vector<T>>(std::move(values));
  const std::size_t bytes = held->size() * sizeof(T);
  return {"warm-up", std::move(shape), type, reinterpret_cast<const std::byte*>(held->data()), bytes, held};
}

/// Samples of one moving object, all at one point: they are seen without a depth map.
IncomingRound usual_round(std::uint32_t n) {
  using bus::ElementType;
  const bus::TensorView vectors = tensor_of({n, 3}, ElementType::F32, std::vector<glm::vec3>(n, {0, 0, 1}));
  const bus::TensorView ones = tensor_of({n}, ElementType::F32, std::vector<float>(n, 1));
  const bus::TensorView zeros = tensor_of({n}, ElementType::U32, std::vector<std::uint32_t>(n));
  const bus::TensorView depth = tensor_of({1, 1, 1}, ElementType::F32, std::vector<float>(1));
  RoundInfo info;
  info.cameras = {look_at({0, 0, 0}, {0, 0, 1}, 1, 1, 1)};
  info.objects[0] = {};
  info.height = info.width = 1;
  return {std::move(info), n, vectors, vectors, vectors, vectors, ones, ones, zeros, zeros, depth};
}

}  // namespace

void CudaMapper::warm_up(std::uint32_t usual_samples) {
  row_cell_.resize(kUsualCells);
  row_start_.resize(kUsualCells);
  row_inserted_.resize(kUsualCells);
  {
    const auto batches = pool_.take(std::size_t{usual_samples} * kInsertBytes, "the Gaussians of a usual round");
    const std::unique_ptr<Round> round = take(usual_round(usual_samples));
    const GrowOptions options{.viewer = {0, 0, 1}, .room = kFewGaussians};
    const Growth growth = grow(*round, options);
    assert(!growth.batches.empty());  // as usual_samples are more than make a cell seen
    (void)grow(*round, options);
    (void)holds_any(growth.batches.front());
    (void)cells();
  }
  clear();
  host_bytes_ = 0;
}

}  // namespace splatbus::expander::cuda
