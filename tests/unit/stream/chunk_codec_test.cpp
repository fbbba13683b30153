#include <gtest/gtest.h>

#include <numeric>
#include <random>

#include "quantize_once.h"
#include "stream/codecs.h"
#include "toy_model.h"

namespace splatbus::stream {
namespace {

struct Chunk {
  StreamLayout layout;
  QuantizedGaussians gaussians;
};

Chunk toy_chunk(std::size_t count, Appearance appearance = Appearance::Transfer, int degree = 1) {
  const GaussiansBuffer model = test::toy_model(count, 3, 1, appearance, degree);
  Chunk chunk{StreamLayout(model.layout(), test::choose_mean_step(model.view())), {}};
  chunk.gaussians = test::quantize_once(model.view(), chunk.layout).gaussians;
  std::vector<std::uint32_t> all(count);
  std::iota(all.begin(), all.end(), 0U);
  chunk.gaussians = chunk.gaussians.gather(morton_order(chunk.gaussians, chunk.layout, all));
  std::ranges::fill(chunk.gaussians.gaussian_id, 0);
  return chunk;
}

class ChunkCodec : public testing::TestWithParam<std::pair<Appearance, int>> {};

TEST_P(ChunkCodec, IsLossless) {
  for (const std::size_t count : {std::size_t{1}, std::size_t{2}, std::size_t{100}, std::size_t{5000}}) {
    const Chunk chunk = toy_chunk(count, GetParam().first, GetParam().second);
    const Bytes payload = encode_chunk(chunk.gaussians, chunk.layout);
    EXPECT_EQ(decode_chunk(payload, chunk.layout, count), chunk.gaussians) << count << " Gaussians";
  }
}

INSTANTIATE_TEST_SUITE_P(Layouts, ChunkCodec,
                         testing::Values(std::pair{Appearance::Transfer, 0}, std::pair{Appearance::Radiance, 0},
                                         std::pair{Appearance::Radiance, 1}, std::pair{Appearance::Radiance, 2},
                                         std::pair{Appearance::Radiance, 3}));

TEST(ChunkCodecSize, StaysWithinItsBudget) {
  const Chunk chunk = toy_chunk(4096);
  const double bytes = static_cast<double>(encode_chunk(chunk.gaussians, chunk.layout).size()) / 4096;
  RecordProperty("bytes_per_gaussian", std::to_string(bytes));
  EXPECT_LT(bytes, 40);
}

TEST(ChunkCodecHostile, ExtremesOfEveryAttributeSurvive) {
  Chunk chunk = toy_chunk(64);
  for (const AttributeChannels& a : chunk.layout.attributes()) {
    for (int c = 0; c < a.channels; ++c) {
      chunk.gaussians.channels[a.first + c][0] = a.minimum;
      chunk.gaussians.channels[a.first + c][1] = a.maximum;
    }
  }
  chunk.gaussians.object_id[0] = 0xFFFFFFFFU;
  const Bytes payload = encode_chunk(chunk.gaussians, chunk.layout);
  EXPECT_EQ(decode_chunk(payload, chunk.layout, 64), chunk.gaussians);
}

TEST(ChunkCodecHostile, RefusesOtherCountsLayoutsAndValues) {
  Chunk chunk = toy_chunk(64);
  const Bytes payload = encode_chunk(chunk.gaussians, chunk.layout);
  EXPECT_THROW((void)decode_chunk(payload, chunk.layout, 63), StreamError);
  EXPECT_THROW((void)decode_chunk(payload, chunk.layout, 0), StreamError);
  EXPECT_THROW((void)decode_chunk(payload, chunk.layout, std::size_t{1} << 40), StreamError);
  ParameterLayout radiance;
  radiance.appearance = Appearance::Radiance;
  EXPECT_THROW((void)decode_chunk(payload, StreamLayout(radiance, 0.001F), 64), StreamError);
  chunk.gaussians.channels[chunk.layout.at(Attribute::Opacity).first][5] = 256;
  EXPECT_THROW((void)decode_chunk(encode_chunk(chunk.gaussians, chunk.layout), chunk.layout, 64), StreamError);
}

TEST(ChunkCodecHostile, TruncatedPayloadsThrow) {
  const Chunk chunk = toy_chunk(200);
  const Bytes payload = encode_chunk(chunk.gaussians, chunk.layout);
  for (std::size_t size = 0; size < payload.size(); size += 1 + size / 16) {
    const std::span<const std::uint8_t> part(payload.data(), size);
    EXPECT_THROW((void)decode_chunk(part, chunk.layout, 200), StreamError) << size << " of " << payload.size();
  }
}

TEST(ChunkCodecHostile, MutationsThrowOrDecodeWithinTheLimits) {
  const Chunk chunk = toy_chunk(200);
  const Bytes payload = encode_chunk(chunk.gaussians, chunk.layout);
  std::mt19937 random(11);
  int thrown = 0;
  for (int round = 0; round < 3000; ++round) {
    Bytes mutated = payload;
    const std::size_t changes = 1 + random() % 4;
    for (std::size_t k = 0; k < changes; ++k) mutated[random() % mutated.size()] = static_cast<std::uint8_t>(random());
    try {
      const QuantizedGaussians decoded = decode_chunk(mutated, chunk.layout, 200);
      ASSERT_EQ(decoded.count(), 200U);
      for (const AttributeChannels& a : chunk.layout.attributes()) {
        for (const std::int32_t q : decoded.channels[a.first]) ASSERT_TRUE(q >= a.minimum && q <= a.maximum);
      }
    } catch (const StreamError&) {
      ++thrown;
    }
  }
  EXPECT_GT(thrown, 100);
}

}  // namespace
}  // namespace splatbus::stream
