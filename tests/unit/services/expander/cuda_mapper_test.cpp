// The CUDA mapper against the host's: the same rounds through both give the same cells and Gaussians.
#include <gmock/gmock.h>

#include <cstring>
#include <functional>
#include <limits>
#include <map>
#include <stdexcept>
#include <utility>

#include "bus/error.h"
#include "bus/memory.h"
#include "bus/slab_memory.h"
#include "expander/mapper.h"
#include "room_scene.h"
#include "sample_scene.h"

namespace splatbus::expander {
namespace {

using bus::ElementType;

/// A round's tensors one after the other in one slot of a slab, as a capture-bridge leaves them.
class SentRound {
 public:
  SentRound(const InputSamples& samples, Device kind) {
    const auto n = static_cast<std::uint32_t>(samples.size());
    const auto c = static_cast<std::uint32_t>(samples.cameras.size());
    const bus::SlabDescriptor descriptor{.id = 1,
                                         .name = "bridge/input",
                                         .kind = kind,
                                         .slots = 1,
                                         .slot_bytes = std::size_t{n} * 64 + samples.depth_m.size() * 4 + 4096};
    slab_ = bus::create_slab_memory(descriptor, false);
    slab_->begin_write(0);
    std::size_t offset = 0;
    std::vector<std::pair<std::size_t, std::size_t>> parts;  // offset, bytes
    const auto write = [&](const auto& values) {
      const std::size_t bytes = values.size() * sizeof(values[0]);
      bus::copy_memory(slab_->slot_data(0) + offset, kind, values.data(), Device::Cpu, bytes);
      parts.emplace_back(offset, bytes);
      offset += (bytes + 63) / 64 * 64;
    };
    for (const auto* vectors : {&samples.position, &samples.normal, &samples.albedo, &samples.color}) write(*vectors);
    for (const auto* scalars : {&samples.spacing_m, &samples.cosine}) write(*scalars);
    for (const auto* ids : {&samples.object_id, &samples.camera}) write(*ids);
    write(samples.depth_m);
    if (kind == Device::Cuda) bus::finish_copies();
    const std::uint64_t generation = slab_->end_write(0);
    const auto view = [&](std::size_t part, std::vector<std::uint32_t> shape, ElementType type) {
      const auto [at, bytes] = parts[part];
      return bus::TensorView("tensor", std::move(shape), type, slab_, slab_->span(0, at, bytes, generation));
    };
    round_ = std::make_unique<IncomingRound>(
        IncomingRound{samples, n, view(0, {n, 3}, ElementType::F32), view(1, {n, 3}, ElementType::F32),
                      view(2, {n, 3}, ElementType::F32), view(3, {n, 3}, ElementType::F32),
                      view(4, {n}, ElementType::F32), view(5, {n}, ElementType::F32), view(6, {n}, ElementType::U32),
                      view(7, {n}, ElementType::U32), view(8, {c, samples.height, samples.width}, ElementType::F32)});
  }

  [[nodiscard]] const IncomingRound& round() const { return *round_; }
  void overwrite() { slab_->begin_write(0); }

 private:
  std::shared_ptr<bus::Slab> slab_;
  std::unique_ptr<IncomingRound> round_;
};

/// A batch's planes on the host.
InsertBatch on_host(const InsertBatch& batch) {
  InsertBatch copy = batch;
  copy.memory = Device::Cpu;
  copy.data = bus::allocate_memory(Device::Cpu, batch.bytes());
  bus::copy_memory(copy.data.get(), Device::Cpu, batch.data.get(), batch.memory, batch.bytes());
  if (batch.memory == Device::Cuda) bus::finish_copies();
  return copy;
}

double largest_difference(const float* a, const float* b, std::size_t n) {
  double largest = 0;
  for (std::size_t i = 0; i < n; ++i) largest = std::max(largest, std::abs(double{a[i]} - b[i]));
  return largest;
}

void expect_equal(const InsertBatch& expected, const InsertBatch& on_device) {
  const InsertBatch got = on_host(on_device);
  ASSERT_EQ(got.size(), expected.size());
  const std::size_t n = got.size();
  const InsertPlanes a = expected.planes(), b = got.planes();
  EXPECT_EQ(std::memcmp(a.cell, b.cell, n * sizeof(*a.cell)), 0);
  EXPECT_EQ(std::memcmp(a.object_id, b.object_id, n * sizeof(*a.object_id)), 0);
  EXPECT_LE(largest_difference(a.mean, b.mean, 3 * n), 1e-6);
  EXPECT_LE(largest_difference(a.log_scale, b.log_scale, 3 * n), 2e-6);
  EXPECT_LE(largest_difference(a.rotation, b.rotation, 4 * n), 1e-6);
  EXPECT_LE(largest_difference(a.opacity_logit, b.opacity_logit, n), 1e-6);
  EXPECT_LE(largest_difference(a.albedo, b.albedo, 3 * n), 0);
  EXPECT_LE(largest_difference(a.normal, b.normal, 3 * n), 1e-6);
  EXPECT_LE(largest_difference(a.visibility, b.visibility, n), 1e-4);
}

std::map<CellId, std::pair<std::uint32_t, std::uint32_t>> cell_map(Mapper& mapper) {
  std::map<CellId, std::pair<std::uint32_t, std::uint32_t>> cells;
  for (const CellCounts& cell : mapper.cells()) cells[cell.cell] = {cell.samples, cell.points};
  return cells;
}

/// Spoils some samples in every way that makes one garbage; returns how many.
std::size_t spoil(InputSamples& samples) {
  const float nan = std::numeric_limits<float>::quiet_NaN(), infinity = std::numeric_limits<float>::infinity();
  const std::vector<std::function<void(std::size_t)>> ways = {
      [&](std::size_t i) { samples.position[i].y = nan; },
      [&](std::size_t i) { samples.position[i].x = infinity; },
      [&](std::size_t i) {
        samples.normal[i] = {0, 0, 0};
      },
      [&](std::size_t i) { samples.normal[i] *= 1.2F; },
      [&](std::size_t i) { samples.albedo[i].z = nan; },
      [&](std::size_t i) { samples.color[i].x = -infinity; },
      [&](std::size_t i) { samples.cosine[i] = nan; },
      [&](std::size_t i) { samples.spacing_m[i] = 0; },
      [&](std::size_t i) { samples.spacing_m[i] = nan; },
      [&](std::size_t i) { samples.spacing_m[i] = 1e9F; },
      [&](std::size_t i) { samples.camera[i] = static_cast<std::uint32_t>(samples.cameras.size()); },
      [&](std::size_t i) { samples.camera[i] = 0xFFFFFFFF; },
  };
  std::size_t spoilt = 0;
  for (std::size_t i = 5; i < samples.size(); i += 97) ways[spoilt++ % ways.size()](i);
  return spoilt;
}

class CudaMapperTest : public testing::Test {
 protected:
  static constexpr float kCellSize_m = 0.25F;

  void SetUp() override {
    try {
      (void)bus::choose_backend("cuda");
    } catch (const bus::Error& error) {
      GTEST_SKIP() << error.what();
    }
    const MapperOptions options{.cell_size_m = kCellSize_m, .usual_samples = 4096};
    cpu_ = make_mapper(Device::Cpu, options);
    cuda_ = make_mapper(Device::Cuda, options);
  }

  /// One round through both; returns how many Gaussians it gave.
  std::size_t compare(const InputSamples& samples, const GrowOptions& options = {}) {
    const SentRound on_host(samples, Device::Cpu), on_device(samples, Device::Cuda);
    const auto expected = cpu_->take(on_host.round());
    const auto got = cuda_->take(on_device.round());
    if (expected == nullptr || got == nullptr) {
      ADD_FAILURE() << "a round was lost";
      return 0;
    }
    EXPECT_EQ(got->size(), expected->size());
    EXPECT_EQ(got->dropped(), expected->dropped());
    const Growth a = cpu_->grow(*expected, options), b = cuda_->grow(*got, options);
    EXPECT_EQ(b.unseen, a.unseen);
    EXPECT_EQ(b.chosen, a.chosen);
    EXPECT_EQ(b.batches.size(), a.batches.size());
    for (std::size_t i = 0; i < std::min(a.batches.size(), b.batches.size()); ++i) {
      expect_equal(a.batches[i], b.batches[i]);
    }
    EXPECT_EQ(cell_map(*cuda_), cell_map(*cpu_));
    EXPECT_EQ(cuda_->modelled_points(), cpu_->modelled_points());
    last_ = b;
    return a.chosen;
  }

  std::unique_ptr<Mapper> cpu_, cuda_;
  Growth last_;  // the device's
};

TEST_F(CudaMapperTest, RoundsGrowTheSameModel) {
  test::RoomScene scene;
  InputSamples first = test::room_round(scene, 6, 64);
  const std::size_t spoilt = spoil(first);
  EXPECT_GT(spoilt, 200U);
  EXPECT_GT(compare(first, {.batch_size = 5001}), 20000U);
  EXPECT_EQ(compare(first), 0U) << "the same again";
  // Seen from elsewhere, with the ball moved and turned: gaps are topped up.
  scene.world_from_ball = {glm::angleAxis(0.7F, glm::normalize(glm::vec3(1, 2, 3))), {-0.4F, 1.1F, 0.6F}};
  EXPECT_GT(compare(test::room_round(scene, 7, 80, 0.3F)), 100U);
  EXPECT_EQ(cuda_->host_copied_bytes(), 0U);
}

TEST_F(CudaMapperTest, OptionsMeanTheSame) {
  const test::RoomScene scene;
  const InputSamples round = test::room_round(scene, 4, 48);
  GrowOptions options{.viewer = {1, 1, 1}, .room = 777, .batch_size = 100};
  options.grid.candidate_radius_m = 3;
  EXPECT_EQ(compare(round, options), 777U) << "no more room";
  options.room = SIZE_MAX;
  options.grid.min_samples = 30;
  options.grid.top_up_fraction = 0.5F;
  options.visibility = {.min_cosine = 0.5F, .depth_tolerance = 0.001F};
  EXPECT_GT(compare(round, options), 100U);
  options.grid.top_up_distance = 10;  // spheres that reach into all neighbours
  options.grid.new_distance = 10;
  options.grid.candidate_radius_m = 100;
  EXPECT_GT(compare(test::room_round(scene, 5, 56, 0.4F), options), 100U);
}

TEST_F(CudaMapperTest, NothingIsNothing) {
  EXPECT_EQ(compare(test::empty_round()), 0U);
  InputSamples garbage = test::floor_round(-1, 1);
  for (float& spacing : garbage.spacing_m) spacing = -1;
  EXPECT_EQ(compare(garbage), 0U);
  EXPECT_EQ(compare(test::floor_round(-1, 1), {.room = 0}), 0U);
  EXPECT_GT(compare(test::floor_round(-1, 1)), 0U);
}

TEST_F(CudaMapperTest, CellsAtTheBorderOfWhatIdsName) {
  InputSamples samples = test::empty_round();
  samples.objects[0x3FFFF] = {};
  for (const float far : {1e9F, 262143.0F * 0.25F, 4095.9F, 4095.6F, -4096.0F, -4100.0F}) {
    for (int i = 0; i < 6; ++i) {
      const float offset = 0.01F * static_cast<float>(i);
      test::add_sample(samples, {far, offset, offset}, 0x3FFFF);
      test::add_sample(samples, {far + offset, far, far}, 0x3FFFF);
    }
  }
  GrowOptions options;
  options.grid.candidate_radius_m = 1e12F;
  EXPECT_GT(compare(samples, options), 0U);
}

TEST_F(CudaMapperTest, RoundsOfTheHostAreTaken) {
  const InputSamples samples = test::room_round({}, 2, 64);
  const SentRound sent(samples, Device::Cpu);
  const auto round = cuda_->take(sent.round());
  ASSERT_NE(round, nullptr);
  EXPECT_EQ(cuda_->grow(*round, {}).chosen, cpu_->grow(*cpu_->take(sent.round()), {}).chosen);
  EXPECT_EQ(cuda_->host_copied_bytes(), samples.size() * 64 + samples.depth_m.size() * 4);
}

TEST_F(CudaMapperTest, ARoundThatIsOverwrittenIsLost) {
  SentRound sent(test::room_round({}, 2, 32), Device::Cuda);
  sent.overwrite();
  EXPECT_EQ(cuda_->take(sent.round()), nullptr);
}

TEST_F(CudaMapperTest, BatchesAreFoundAndAddedAgain) {
  ASSERT_GT(compare(test::room_round({}, 4, 48), {.batch_size = 2000}), 8000U);
  const std::vector<InsertBatch> batches = last_.batches;
  const auto cells = cell_map(*cuda_);
  for (const InsertBatch& batch : batches) EXPECT_TRUE(cuda_->holds_any(batch));
  cuda_->clear();
  EXPECT_EQ(cuda_->cell_count(), 0U);
  EXPECT_FALSE(cuda_->holds_any(batches[0]));
  for (const InsertBatch& batch : batches) {
    EXPECT_FALSE(cuda_->holds_any(batch));
    cuda_->add(batch);
    EXPECT_TRUE(cuda_->holds_any(batch));
  }
  for (const auto& [cell, counts] : cell_map(*cuda_)) EXPECT_EQ(counts.second, cells.at(cell).second);
  EXPECT_EQ(compare(test::room_round({}, 4, 48)), 0U) << "all of it is modelled again";
}

TEST_F(CudaMapperTest, WithoutMemoryWhatIsModelledStays) {
  using testing::HasSubstr;
  ASSERT_GT(compare(test::room_round({}, 4, 40)), 5000U);
  ASSERT_EQ(compare(test::room_round({}, 4, 40)), 0U);
  // As large as the round before, so that only the Gaussians need memory; then larger in all.
  for (const auto& [size, what] : {std::pair{40U, "the new Gaussians"}, std::pair{64U, "choosing among samples"}}) {
    const InputSamples samples = test::room_round({}, 4, size, 0.3F);
    const auto cells = cell_map(*cuda_);
    const std::size_t points = cuda_->modelled_points();
    const SentRound sent(samples, Device::Cuda);
    const auto round = cuda_->take(sent.round());
    ASSERT_NE(round, nullptr);
    cuda_->limit_device_memory(1);
    EXPECT_THAT([&] { (void)cuda_->grow(*round, {}); },
                testing::ThrowsMessage<std::runtime_error>(
                    testing::AllOf(HasSubstr("no device memory"), HasSubstr(what), HasSubstr("bytes asked for"))));
    EXPECT_THROW((void)cuda_->take(sent.round()), std::runtime_error);
    EXPECT_EQ(cell_map(*cuda_), cells);
    EXPECT_EQ(cuda_->modelled_points(), points);
    cuda_->limit_device_memory(SIZE_MAX);
    EXPECT_GT(compare(samples), 100U) << "as if nothing had been";
  }
}

}  // namespace
}  // namespace splatbus::expander
