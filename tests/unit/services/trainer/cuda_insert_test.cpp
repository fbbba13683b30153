// model/insert read into device memory against the same read into the host's, from slabs of both kinds.
#include <limits>

#include "bus/tensor_ring.h"
#include "cuda_model_fixture.h"
#include "insert_sources.h"
#include "trainer/insert_reader.h"
#include "wire/convert.h"
#include "wire/model_generated.h"

namespace splatbus::trainer {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

class CudaInsert : public bus_test::BusTest {
 protected:
  void SetUp() override {
    if (!has_device()) GTEST_SKIP() << "no CUDA device";
    bus_test::meet(publisher_, subscriber_);
  }

  bus::Message publish(const InsertBatch& batch, Device memory) {
    const std::vector<bus::TensorSource> sources = insert_sources(batch);
    bus::TensorRing& ring = memory == Device::Cpu ? host_ring_ : device_ring_;
    publisher_.publish(topics::kModelInsert, {.tensors = ring.write(sources)}, [&](auto& builder, auto header) {
      const auto light = to_wire(builder, batch.light);
      return wire::CreateModelInsert(builder, header, batch.batch, 0, light);
    });
    return subscriber_.receive(bus_test::patience).value();
  }

  static InsertBatch damaged_batch(std::size_t count) {
    InsertBatch batch = sample_batch(1, 1, count);
    const std::size_t n = count;
    batch.mean[3] = kNan;
    batch.mean[n + 4] = 1e9F;
    batch.log_scale[2 * n + 5] = std::numeric_limits<float>::infinity();
    for (std::size_t c = 0; c < 4; ++c) batch.rotation[c * n + 6] = 0;
    for (std::size_t c = 0; c < 4; ++c) batch.rotation[c * n + 7] = static_cast<float>(c) - 2.5F;  // kept, normalised
    batch.opacity_logit[8] = -std::numeric_limits<float>::infinity();
    batch.opacity_logit[9] = 100.0F;  // kept, clamped
    batch.albedo[n + 10] = kNan;
    batch.albedo[n + 11] = 1.5F;
    batch.visibility[12] = kNan;
    batch.visibility[13] = -3.0F;
    batch.normal[2 * n + 14] = kNan;
    for (std::size_t c = 0; c < 3; ++c) batch.normal[c * n + 15] *= 1.5F;
    for (std::size_t c = 0; c < 3; ++c) batch.normal[c * n + 16] *= 1.03F;
    batch.log_scale[17] = -50.0F;
    batch.mean[n - 1] = kNan;
    return batch;
  }

  static void expect_same_rows(const InsertBatch& host, const InsertBatch& device) {
    ASSERT_EQ(host.count, device.count);
    EXPECT_EQ(host.dropped, device.dropped);
    const InsertRows rows = device.rows();
    ASSERT_EQ(device.memory(), Device::Cuda);
    const auto compare = [&](const char* name, const auto* on_host, const auto* on_device, int channels) {
      const auto copied =
          host_copy(on_device, Device::Cuda, rows.stride * static_cast<std::size_t>(channels - 1) + device.count);
      expect_same_planes(name, on_host, host.count, copied.data(), rows.stride, channels, host.count, 1e-6);
    };
    const InsertRows expected = host.rows();
    compare("cell", expected.cell, rows.cell, 1);
    compare("object_id", expected.object_id, rows.object_id, 1);
    compare("mean", expected.mean, rows.mean, 3);
    compare("log_scale", expected.log_scale, rows.log_scale, 3);
    compare("rotation", expected.rotation, rows.rotation, 4);
    compare("opacity_logit", expected.opacity_logit, rows.opacity_logit, 1);
    compare("albedo", expected.albedo, rows.albedo, 3);
    compare("normal", expected.normal, rows.normal, 3);
    compare("visibility", expected.visibility, rows.visibility, 1);
  }

  std::shared_ptr<bus::Context> context_ = connect("expander");
  bus::Publisher publisher_{context_};
  bus::Subscriber subscriber_{connect("reader"), {"model/insert"}};
  bus::TensorRing host_ring_{context_, "host", 2};
  bus::TensorRing device_ring_{context_, "device", 2, 0, Device::Cuda};
  std::atomic<std::uint64_t> host_bytes_{0}, device_bytes_{0};
};

TEST_F(CudaInsert, KeepsTheSameRowsFromEitherMemory) {
  const auto on_host = make_insert_reader(Device::Cpu, host_bytes_);
  const auto on_device = make_insert_reader(Device::Cuda, device_bytes_);
  for (const std::size_t count : {std::size_t{20}, std::size_t{5000}}) {
    for (const Device producer : {Device::Cuda, Device::Cpu}) {
      const bus::Message message = publish(damaged_batch(count), producer);
      const InsertReading expected = on_host->read(message);
      const std::uint64_t before = device_bytes_;
      const InsertReading reading = on_device->read(message);
      ASSERT_FALSE(expected.lost);
      ASSERT_FALSE(reading.lost);
      EXPECT_EQ(expected.batch.dropped, 10U);
      expect_same_rows(expected.batch, reading.batch);
      EXPECT_EQ(device_bytes_ - before, producer == Device::Cuda ? 0 : insert_rows_bytes(count));
    }
  }
  EXPECT_EQ(host_bytes_, 2 * insert_rows_bytes(20) + 2 * insert_rows_bytes(5000));
}

TEST_F(CudaInsert, WhatWasOverwrittenIsLostAndRowsOfOldBatchesStay) {
  const auto reader = make_insert_reader(Device::Cuda, device_bytes_);
  const auto on_host = make_insert_reader(Device::Cpu, host_bytes_);
  const bus::Message first = publish(sample_batch(1, 1, 100, 1), Device::Cuda);
  const InsertReading expected = on_host->read(first);
  const InsertReading held = reader->read(first);
  for (unsigned seed = 2; seed < 6; ++seed) {
    const bus::Message next = publish(sample_batch(1, seed, 100, seed), Device::Cuda);
    EXPECT_FALSE(reader->read(next).lost);
  }
  EXPECT_TRUE(reader->read(first).lost);
  expect_same_rows(expected.batch, held.batch);
}

TEST_F(CudaInsert, NothingValidAndNothingAtAll) {
  const auto reader = make_insert_reader(Device::Cuda, device_bytes_);
  InsertBatch batch = sample_batch(1, 1, 10);
  std::fill(batch.mean.begin(), batch.mean.end(), kNan);
  const InsertReading reading = reader->read(publish(batch, Device::Cuda));
  EXPECT_FALSE(reading.lost);
  EXPECT_EQ(reading.batch.count, 0U);
  EXPECT_EQ(reading.batch.dropped, 10U);
  ModelStore store(connect("trainer"), {}, 64, 1000, Device::Cuda);
  store.change([&] { store.append(reading.batch); });
  EXPECT_TRUE(store.holds(reading.batch.epoch, 1));
  EXPECT_EQ(store.count(), 0U);
}

TEST_F(CudaInsert, ABatchOfDeviceRowsIsAppendedAsTheHostsIs) {
  const auto reader = make_insert_reader(Device::Cuda, device_bytes_);
  const auto on_host = make_insert_reader(Device::Cpu, host_bytes_);
  const std::size_t count = 200000;
  const bus::Message message = publish(damaged_batch(count), Device::Cuda);
  ModelStore host(connect("host"), {}, count, count, Device::Cpu);
  ModelStore device(connect("device"), {}, count, count, Device::Cuda);
  host.change([&] { host.append(on_host->read(message).batch); });
  device.change([&] { device.append(reader->read(message).batch); });
  EXPECT_EQ(device_bytes_, 0U);
  expect_same(HostPlanes(host), HostPlanes(device), 1e-6);
}

}  // namespace
}  // namespace splatbus::trainer
