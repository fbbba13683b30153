// model/insert: the checks of its rows on either device, the messages it comes in, and how many wait.
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>
#include <numeric>

#include "../../bus/bus_fixture.h"
#include "bus/tensor_ring.h"
#include "sample_batch.h"
#include "trainer/commands.h"
#include "trainer/insert_reader.h"
#include "wire/convert.h"
#include "wire/model_generated.h"

namespace splatbus::trainer {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();

class InsertRowsOn : public testing::TestWithParam<Device> {
 protected:
  void SetUp() override {
    if (!has_device(GetParam())) GTEST_SKIP() << "no such device";
  }

  static SampleBatch checked(const SampleBatch& announced) {
    const InsertBatch from = announced.on(GetParam());
    InsertBatch to = announced.on(GetParam());
    const device::Stream stream(GetParam());
    to.count = keep_valid_rows(stream, from.rows, static_cast<std::uint32_t>(announced.count), to.rows);
    return SampleBatch::of(to, GetParam());
  }
};

TEST_P(InsertRowsOn, KeepsWhatIsSound) {
  SampleBatch before = sample_batch(1, 1, 10);
  std::iota(before.object_id.begin(), before.object_id.end(), 1U);
  const SampleBatch batch = checked(before);
  EXPECT_EQ(batch.count, 10U);
  EXPECT_EQ(batch.mean, before.mean);
  EXPECT_EQ(batch.object_id, before.object_id);
}

TEST_P(InsertRowsOn, DropsTheRowThatIsNotAGaussianAndNoOther) {
  const std::vector<std::function<void(SampleBatch&)>> damages = {
      [](SampleBatch& b) { b.mean[3] = kNan; },
      [](SampleBatch& b) { b.mean[10 + 3] = kInfinity; },
      [](SampleBatch& b) { b.mean[3] = 1e9F; },
      [](SampleBatch& b) { b.log_scale[20 + 3] = kNan; },
      [](SampleBatch& b) { b.rotation[3] = kNan; },
      [](SampleBatch& b) {
        for (std::size_t c = 0; c < 4; ++c) b.rotation[c * 10 + 3] = 0;
      },
      [](SampleBatch& b) { b.opacity_logit[3] = -kInfinity; },
      [](SampleBatch& b) { b.albedo[3] = kNan; },
      [](SampleBatch& b) { b.visibility[3] = kNan; },
      [](SampleBatch& b) { b.normal[3] = kNan; },
      [](SampleBatch& b) {
        for (std::size_t c = 0; c < 3; ++c) b.normal[c * 10 + 3] = 0;
      },
  };
  for (std::size_t d = 0; d < damages.size(); ++d) {
    SampleBatch batch = sample_batch(1, 1, 10);
    std::iota(batch.object_id.begin(), batch.object_id.end(), 1U);
    const SampleBatch before = batch;
    damages[d](batch);
    batch = checked(batch);
    ASSERT_EQ(batch.count, 9U) << "damage " << d;
    ASSERT_EQ(batch.mean.size(), 27U);
    EXPECT_EQ(batch.mean[2], before.mean[2]);
    EXPECT_EQ(batch.mean[9 + 3], before.mean[10 + 4]) << "rows after it move up, in every plane";
    ASSERT_EQ(batch.object_id.size(), 9U);
    EXPECT_EQ(batch.object_id[3], before.object_id[4]);
  }
}

TEST_P(InsertRowsOn, NormalisesAndClampsTheRest) {
  SampleBatch batch = sample_batch(1, 1, 4);
  for (std::size_t c = 0; c < 4; ++c) batch.rotation[c * 4 + 1] *= 3.0F;
  batch.albedo[2] = 1.5F;
  batch.visibility[2] = -0.25F;
  batch.opacity_logit[2] = 100.0F;
  batch.log_scale[3] = 50.0F;
  batch.log_scale[2 * 4] = -50.0F;
  batch = checked(batch);
  float square = 0;
  for (std::size_t c = 0; c < 4; ++c) square += batch.rotation[c * 4 + 1] * batch.rotation[c * 4 + 1];
  EXPECT_NEAR(square, 1.0F, 1e-5F);
  EXPECT_FLOAT_EQ(batch.albedo[2], 1.0F);
  EXPECT_FLOAT_EQ(batch.visibility[2], 0.0F);
  EXPECT_LT(batch.opacity_logit[2], 20.0F);
  EXPECT_LT(std::exp(batch.log_scale[3]), 3000.0F) << "metres";
  EXPECT_GT(std::exp(batch.log_scale[3]), 1000.0F);
  EXPECT_GT(std::exp(batch.log_scale[2 * 4]), 1e-7F);
  EXPECT_FLOAT_EQ(std::exp(batch.log_scale[0]), 0.1F) << "as it was";
}

std::string name_of_param(const testing::TestParamInfo<Device>& device) {
  return name_of(device.param);
}
INSTANTIATE_TEST_SUITE_P(Devices, InsertRowsOn, testing::Values(Device::Cpu, Device::Cuda), name_of_param);

/// Of the device that reads; messages come from slabs of both.
class InsertReaderOn : public bus_test::BusTest, public testing::WithParamInterface<Device> {
 protected:
  void SetUp() override {
    if (!has_device(GetParam())) GTEST_SKIP() << "no such device";
    bus_test::meet(publisher_, subscriber_);
  }

  bus::Message publish(const SampleBatch& batch, Device memory) {
    std::unique_ptr<bus::TensorRing>& ring = rings_[memory];
    if (!ring) ring = std::make_unique<bus::TensorRing>(context_, name_of(memory), 2, 0, memory);
    publisher_.publish(topics::kModelInsert, {.tensors = ring->write(batch.tensors())},
                       [&](auto& builder, auto header) {
                         const auto light = to_wire(builder, batch.scene.light);
                         return wire::CreateModelInsert(builder, header, batch.batch, 0, light);
                       });
    return subscriber_.receive(bus_test::patience).value();
  }

  std::shared_ptr<bus::Context> context_ = connect("expander");
  bus::Publisher publisher_{context_};
  bus::Subscriber subscriber_{connect("reader"), {"model/insert"}};
  std::map<Device, std::unique_ptr<bus::TensorRing>> rings_;
  std::atomic<std::uint64_t> host_bytes_{0};
};

TEST_P(InsertReaderOn, TakesTheSoundRowsOfAMessage) {
  InsertReader reader(GetParam(), host_bytes_);
  for (const std::size_t count : {std::size_t{20}, std::size_t{5001}}) {
    for (const Device producer : {Device::Cpu, Device::Cuda}) {
      if (!has_device(producer)) continue;
      SampleBatch sent = sample_batch(1, 7, count);
      std::iota(sent.object_id.begin(), sent.object_id.end(), 1U);
      sent.mean[3] = kNan;
      sent.albedo[count + 5] = kInfinity;
      const std::uint64_t before = host_bytes_;
      const InsertReading reading = reader.read(publish(sent, producer));
      ASSERT_FALSE(reading.lost);
      EXPECT_EQ(reading.batch.batch, 7U);
      EXPECT_EQ(reading.batch.dropped, 2U);
      const SampleBatch taken = SampleBatch::of(reading.batch, GetParam());
      ASSERT_EQ(taken.count, count - 2);
      EXPECT_EQ(taken.mean[3], sent.mean[4]);
      EXPECT_EQ(taken.object_id[4], sent.object_id[6]);
      EXPECT_EQ(taken.mean.back(), sent.mean.back());
      EXPECT_EQ(reading.batch.scene.light.sun_irradiance, sent.scene.light.sun_irradiance);
      const bool stays = producer == Device::Cuda && GetParam() == Device::Cuda;
      EXPECT_EQ(host_bytes_ - before, stays ? 0 : insert_rows_bytes(count));
    }
  }
}

TEST_P(InsertReaderOn, WhatWasOverwrittenIsLostAndRowsOfOldBatchesStay) {
  InsertReader reader(GetParam(), host_bytes_);
  const SampleBatch sent = sample_batch(1, 1, 100, 1);
  const bus::Message first = publish(sent, Device::Cpu);
  const InsertReading held = reader.read(first);
  for (unsigned seed = 2; seed < 6; ++seed) {
    EXPECT_FALSE(reader.read(publish(sample_batch(1, seed, 100, seed), Device::Cpu)).lost);
  }
  EXPECT_TRUE(reader.read(first).lost);
  EXPECT_EQ(SampleBatch::of(held.batch, GetParam()).mean, sent.mean);
}

TEST_P(InsertReaderOn, NothingValidAndNothingAtAll) {
  InsertReader reader(GetParam(), host_bytes_);
  SampleBatch batch = sample_batch(1, 1, 10);
  std::fill(batch.mean.begin(), batch.mean.end(), kNan);
  const InsertReading reading = reader.read(publish(batch, Device::Cpu));
  EXPECT_EQ(reading.batch.count, 0U);
  EXPECT_EQ(reading.batch.dropped, 10U);
  EXPECT_FALSE(reading.lost);
}

INSTANTIATE_TEST_SUITE_P(Devices, InsertReaderOn, testing::Values(Device::Cpu, Device::Cuda), name_of_param);

TEST(Commands, HoldNoMoreRowsThanTheirBound) {
  InsertBatch large;
  large.count = Commands::kMaxRows - 10;
  Commands commands;
  EXPECT_TRUE(commands.add(InsertBatch(large)));
  EXPECT_TRUE(commands.add(sample_batch(1, 1, 10).on(Device::Cpu)));
  EXPECT_FALSE(commands.add(sample_batch(1, 2, 1).on(Device::Cpu)));
  EXPECT_TRUE(commands.add(sample_batch(1, 1, 10).on(Device::Cpu))) << "it waits already";
  EXPECT_EQ(commands.inserts.size(), 2U);
}

TEST(Commands, HoldNoMoreBatchesThanTheirBound) {
  Commands commands;
  for (std::uint64_t batch = 0; batch < Commands::kMaxInserts; ++batch) {
    ASSERT_TRUE(commands.add(sample_batch(1, batch, 0).on(Device::Cpu)));
  }
  EXPECT_FALSE(commands.add(sample_batch(1, Commands::kMaxInserts, 0).on(Device::Cpu)));
}

}  // namespace
}  // namespace splatbus::trainer
