#include <gtest/gtest.h>

#include <limits>
#include <random>

#include "stream/bytes.h"
#include "stream/codecs.h"

namespace splatbus::stream {
namespace {

Delta random_delta(std::size_t count, std::size_t channels, std::mt19937& random) {
  Delta delta;
  std::uint32_t slot = 0;
  for (std::size_t i = 0; i < count; ++i) {
    slot += random() % 5;
    delta.slots.push_back(slot++);
  }
  delta.residuals.resize(channels);
  for (auto& plane : delta.residuals) {
    for (std::size_t i = 0; i < count; ++i) plane.push_back(static_cast<std::int32_t>(random() % 9) - 4);
  }
  return delta;
}

TEST(Bytes, ZigzagIsItsOwnInverseAtTheExtremes) {
  for (const std::int64_t v : {std::int64_t{0}, std::int64_t{-1}, std::int64_t{1},
                               std::numeric_limits<std::int64_t>::min(), std::numeric_limits<std::int64_t>::max()}) {
    EXPECT_EQ(unzigzag(zigzag(v)), v);
  }
  EXPECT_EQ(zigzag(-1), 1U);
  EXPECT_EQ(zigzag(1), 2U);
}

TEST(DeltaCodec, RoundTrip) {
  std::mt19937 random(1);
  for (const std::size_t count : {std::size_t{0}, std::size_t{1}, std::size_t{1000}}) {
    Delta delta = random_delta(count, 3, random);
    if (count > 0) delta.residuals[1][0] = std::numeric_limits<std::int32_t>::min();
    const Payload payload = encode_delta(delta);
    const Delta decoded = decode_delta(payload.bytes, payload.raw_bytes, count, 3, 5000);
    EXPECT_EQ(decoded.slots, delta.slots);
    EXPECT_EQ(decoded.residuals, delta.residuals);
  }
}

TEST(DeltaCodec, SmallResidualsOfNeighboursCostAboutAByte) {
  std::mt19937 random(2);
  const Delta delta = random_delta(10000, 3, random);
  EXPECT_LT(encode_delta(delta).bytes.size(), 10000U * 2);
}

TEST(DeltaCodec, IdsAndRunsRoundTrip) {
  const std::vector<std::uint64_t> ids{5, 6, 7, 0, std::numeric_limits<std::uint64_t>::max(), 3};
  Payload payload = encode_ids(ids);
  EXPECT_EQ(decode_ids(payload.bytes, payload.raw_bytes, ids.size()), ids);
  const std::vector<std::uint32_t> objects{1, 1, 1, 2, 0, 0, 0xFFFFFFFFU};
  SlotIds change{.slots = {}, .ids = objects};
  for (std::uint32_t i = 0; i < objects.size(); ++i) change.slots.push_back(3 * i);
  payload = encode_slot_ids(change);
  const SlotIds decoded = decode_slot_ids(payload.bytes, payload.raw_bytes, objects.size(), 3 * objects.size());
  EXPECT_EQ(decoded.slots, change.slots);
  EXPECT_EQ(decoded.ids, objects);
}

TEST(DeltaCodecHostile, RefusesCountsAndSizesThatCannotBe) {
  std::mt19937 random(3);
  const Delta delta = random_delta(100, 3, random);
  const Payload payload = encode_delta(delta);
  const auto decode = [&](std::size_t raw, std::size_t count, std::size_t channels, std::size_t held) {
    (void)decode_delta(payload.bytes, raw, count, channels, held);
  };
  EXPECT_NO_THROW(decode(payload.raw_bytes, 100, 3, 1000));
  EXPECT_THROW(decode(payload.raw_bytes, 100, 3, 100), StreamError) << "slots at or above what is held";
  EXPECT_THROW(decode(payload.raw_bytes, 101, 3, 1000), StreamError);
  EXPECT_THROW(decode(payload.raw_bytes, 99, 3, 1000), StreamError);
  EXPECT_THROW(decode(payload.raw_bytes, 100, 4, 1000), StreamError);
  EXPECT_THROW(decode(payload.raw_bytes, 100, 2, 1000), StreamError);
  EXPECT_THROW(decode(payload.raw_bytes + 1, 100, 3, 1000), StreamError);
  EXPECT_THROW(decode(std::size_t{1} << 40, 100, 3, 1000), StreamError);
  EXPECT_THROW(decode(payload.raw_bytes, std::size_t{1} << 30, 3, std::size_t{1} << 31), StreamError);
  const Bytes bomb = zstd_compress(Bytes(1 << 24));
  EXPECT_THROW((void)decode_delta(bomb, 1 << 24, 100, 3, 1000), StreamError);
  const Payload objects = encode_slot_ids({.slots = {1, 2}, .ids = {7, 7}});
  EXPECT_THROW((void)decode_slot_ids(objects.bytes, objects.raw_bytes, 1, 9), StreamError);
  EXPECT_THROW((void)decode_slot_ids(objects.bytes, objects.raw_bytes, 2, 2), StreamError);
}

TEST(DeltaCodecHostile, MutationsAndTruncationsNeverEscapeTheirBounds) {
  std::mt19937 random(4);
  const Delta delta = random_delta(300, 2, random);
  const Payload payload = encode_delta(delta);
  const Bytes raw = zstd_decompress(payload.bytes, payload.raw_bytes, "test");
  int thrown = 0;
  for (int round = 0; round < 4000; ++round) {
    // Half of the rounds change what Zstandard wrote, half what is inside.
    Bytes bytes = round % 2 ? payload.bytes : raw;
    if (round % 7 == 0) bytes.resize(random() % bytes.size());
    for (int k = 0; k < 3 && !bytes.empty(); ++k) bytes[random() % bytes.size()] = static_cast<std::uint8_t>(random());
    const std::size_t said = round % 2 ? payload.raw_bytes : bytes.size();
    const Bytes sent = round % 2 ? bytes : zstd_compress(bytes);
    try {
      const Delta decoded = decode_delta(sent, said, 300, 2, 2000);
      ASSERT_EQ(decoded.slots.size(), 300U);
      for (std::size_t i = 0; i < 300; ++i) {
        ASSERT_LT(decoded.slots[i], 2000U);
        ASSERT_TRUE(i == 0 || decoded.slots[i] > decoded.slots[i - 1]);
      }
    } catch (const StreamError&) {
      ++thrown;
    }
  }
  EXPECT_GT(thrown, 500);
}

}  // namespace
}  // namespace splatbus::stream
