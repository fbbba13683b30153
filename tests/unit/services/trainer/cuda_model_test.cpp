// The model in device memory against the model in host memory: whatever is done to both leaves the same columns.
#include <limits>
#include <random>
#include <set>

#include "cuda_model_fixture.h"

namespace splatbus::trainer {
namespace {

constexpr std::uint64_t kEpoch = 10;
constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

class CudaModel : public bus_test::BusTest {
 protected:
  void SetUp() override {
    if (!has_device()) GTEST_SKIP() << "no CUDA device";
    start({});
  }

  void start(const ParameterLayout& layout, std::size_t capacity = 64) {
    host_ = std::make_unique<ModelStore>(connect("host"), layout, capacity, 100000, Device::Cpu);
    device_ = std::make_unique<ModelStore>(connect("device"), layout, capacity, 100000, Device::Cuda);
  }

  template <class Work>
  void on_both(Work&& work) {
    for (ModelStore* store : {host_.get(), device_.get()}) {
      store->change([&] { work(*store); });
    }
  }

  void append(std::uint64_t batch, std::size_t count) {
    const InsertBatch rows = sample_batch(kEpoch, batch, count, static_cast<unsigned>(batch));
    on_both([&](ModelStore& store) { store.append(rows); });
  }

  ColumnMoves remove(ModelStore& store, const std::vector<std::uint8_t>& dead) {
    const Placed<std::uint8_t> marks(dead, store.memory());
    ColumnMoves moves;
    store.change([&] { moves = store.remove(marks.data()); });
    return moves;
  }

  void expect_same_stores(double tolerance = 0) {
    const Structure& a = host_->structure();
    const Structure& b = device_->structure();
    EXPECT_EQ(a.count, b.count);
    EXPECT_EQ(a.generation, b.generation);
    EXPECT_EQ(a.removal_generation, b.removal_generation);
    EXPECT_EQ(a.next_gaussian_id, b.next_gaussian_id);
    EXPECT_EQ(host_->capacity(), device_->capacity());
    expect_same(HostPlanes(*host_), HostPlanes(*device_), tolerance);
  }

  std::unique_ptr<ModelStore> host_, device_;
};

TEST_F(CudaModel, LiesOnTheDevice) {
  append(1, 40);
  EXPECT_EQ(device_->memory(), Device::Cuda);
  cudaPointerAttributes attributes{};
  ASSERT_EQ(cudaPointerGetAttributes(&attributes, device_->planes().parameters), cudaSuccess);
  EXPECT_EQ(attributes.type, cudaMemoryTypeDevice);
}

TEST_F(CudaModel, AppendsAndGrows) {
  append(1, 40);
  expect_same_stores();
  append(2, 1000);
  EXPECT_EQ(device_->capacity(), 1040U);
  expect_same_stores();
  append(3, 0);
  append(1, 40);
  EXPECT_EQ(device_->count(), 1040U);
  expect_same_stores();
}

TEST_F(CudaModel, RadianceBeginsWithTheLitColour) {
  for (const int degree : {0, 3}) {
    start({.appearance = Appearance::Radiance, .sh_degree = degree});
    InsertBatch batch = sample_batch(kEpoch, 1, 500);
    std::mt19937 random(3);
    std::normal_distribution<float> normal;
    for (std::size_t i = 0; i < batch.count; ++i) {
      const glm::vec3 n = glm::normalize(glm::vec3(normal(random), normal(random), normal(random)));
      for (std::size_t c = 0; c < 3; ++c) batch.normal[c * batch.count + i] = n[static_cast<int>(c)];
      batch.object_id[i] = static_cast<std::uint32_t>(i % 4);
    }
    for (auto& coefficient : batch.light.ambient_sh) coefficient = {0.3F * normal(random), 0.2F, 0.1F * normal(random)};
    batch.light.sun_direction = glm::normalize(glm::vec3(0.4F, 0.8F, -0.2F));
    batch.objects[1].rotation = glm::normalize(glm::quat(0.7F, 0.3F, -0.4F, 0.1F));
    batch.objects[3].rotation = glm::normalize(glm::quat(0.1F, -0.3F, 0.4F, 0.8F));
    on_both([&](ModelStore& store) { store.append(batch); });
    expect_same_stores(2e-5);
    host_.reset();
    device_.reset();
  }
}

TEST_F(CudaModel, RemovesTheSame) {
  std::mt19937 random(5);
  append(1, 3000);
  for (const double share : {0.0, 0.001, 0.3, 0.9}) {
    std::vector<std::uint8_t> dead(host_->count());
    for (auto& mark : dead) mark = std::generate_canonical<double, 32>(random) < share ? 1 : 0;
    const ColumnMoves on_host = remove(*host_, dead);
    const ColumnMoves on_device = remove(*device_, dead);
    EXPECT_EQ(on_host.new_count, on_device.new_count);
    ASSERT_EQ(on_host.moved, on_device.moved);
    EXPECT_EQ(host_copy(on_host.from, Device::Cpu, on_host.moved),
              host_copy(on_device.from, Device::Cuda, on_host.moved));
    EXPECT_EQ(host_copy(on_host.to, Device::Cpu, on_host.moved), host_copy(on_device.to, Device::Cuda, on_host.moved));
    expect_same_stores();
  }
  std::vector<std::uint8_t> tail(host_->count(), 0);
  tail.back() = 1;
  EXPECT_EQ(remove(*host_, tail).moved, 0U);
  EXPECT_EQ(remove(*device_, tail).moved, 0U);
  expect_same_stores();
  const std::vector<std::uint8_t> all(host_->count(), 1);
  remove(*host_, all);
  remove(*device_, all);
  EXPECT_EQ(device_->count(), 0U);
  remove(*host_, {});
  remove(*device_, {});
  append(2, 10);
  expect_same_stores();
}

TEST_F(CudaModel, TakesVisibilityFromEitherMemory) {
  append(1, 300);
  std::vector<float> values(300);
  for (std::size_t i = 0; i < values.size(); ++i) values[i] = static_cast<float>(i) / 100 - 1;
  values[7] = kNan;
  values[8] = std::numeric_limits<float>::infinity();
  const auto generation = device_->structure().generation;
  for (const Device memory : {Device::Cpu, Device::Cuda}) {
    const Placed<float> placed(values, memory);
    EXPECT_TRUE(host_->set_visibility(generation, placed.data(), memory, 290));
    EXPECT_TRUE(device_->set_visibility(generation, placed.data(), memory, 290));
    expect_same_stores();
    EXPECT_EQ(HostPlanes(*device_)->visibility[7], 0.0F);
    EXPECT_EQ(HostPlanes(*device_)->visibility[289], 1.0F);
    EXPECT_FALSE(device_->set_visibility(generation, placed.data(), memory, 301));
  }
}

TEST_F(CudaModel, DuplicatesTheSame) {
  append(1, 60);
  on_both([](ModelStore& store) { store.duplicate({3, 59, 3, 0, 17}); });
  expect_same_stores();
  const auto ids = HostPlanes(*device_).ids();
  EXPECT_EQ(std::set<std::uint64_t>(ids.begin(), ids.end()).size(), 65U);
}

TEST_F(CudaModel, WhatARemovalCutShortLeavesIsRepairedTheSame) {
  append(1, 60);
  for (ModelStore* store : {host_.get(), device_.get()}) {
    const auto set = [&](auto* plane, std::size_t column, auto value) {
      bus::copy_memory(plane + column, store->memory(), &value, Device::Cpu, sizeof(value));
    };
    const ModelPlanes& planes = store->planes();
    set(planes.gaussian_id, 4, std::uint64_t{60});  // column 59 once more
    set(planes.parameters + ParameterLayout::kOpacityLogit * planes.capacity, 9, kInvisibleLogit);
    set(planes.average + 12 * planes.capacity, 11, kNan);
    set(planes.normal, 12, std::numeric_limits<float>::infinity());
    bus::finish_copies();
  }
  host_.reset();
  device_.reset();
  start({});
  EXPECT_EQ(device_->count(), 56U);
  EXPECT_EQ(device_->origin(), host_->origin());
  expect_same_stores();
}

}  // namespace
}  // namespace splatbus::trainer
