#include <fmt/format.h>

#include <cassert>

#include "stream/bytes.h"
#include "stream/codecs.h"

namespace splatbus::stream {

namespace {

Payload finish(const Bytes& raw) {
  return {zstd_compress(raw), static_cast<std::uint32_t>(raw.size())};
}

void put_slots(Bytes& out, std::span<const std::uint32_t> ascending) {
  std::vector<std::uint64_t> gaps;
  gaps.reserve(ascending.size());
  std::uint64_t next = 0;
  for (const std::uint32_t slot : ascending) {
    assert(slot >= next);
    gaps.push_back(slot - next);
    next = std::uint64_t{slot} + 1;
  }
  put_byte_planes(out, gaps);
}

std::vector<std::uint32_t> read_slots(ByteReader& reader, std::size_t count, std::size_t held, std::string_view what) {
  std::vector<std::uint32_t> slots;
  slots.reserve(count);
  std::uint64_t next = 0;
  for (const std::uint64_t gap : reader.byte_planes(count, 4)) {
    const std::uint64_t slot = next + gap;
    if (slot >= held) throw StreamError(fmt::format("{}: slot {} of {} held", what, slot, held));
    slots.push_back(static_cast<std::uint32_t>(slot));
    next = slot + 1;
  }
  return slots;
}

void require_count(std::string_view what, std::size_t count, std::size_t limit) {
  if (count > limit) throw StreamError(fmt::format("{}: {} Gaussians, at most {} are possible", what, count, limit));
}

void require_raw_bytes(std::string_view what, std::size_t raw_bytes, std::size_t limit) {
  if (raw_bytes > limit) {
    throw StreamError(fmt::format("{}: {} bytes raw, at most {} are possible", what, raw_bytes, limit));
  }
}

}  // namespace

Payload encode_delta(const Delta& delta) {
  Bytes raw;
  put_slots(raw, delta.slots);
  std::vector<std::uint64_t> plane(delta.slots.size());
  for (const auto& residuals : delta.residuals) {
    for (std::size_t i = 0; i < plane.size(); ++i) plane[i] = zigzag(residuals[i]);
    put_byte_planes(raw, plane);
  }
  return finish(raw);
}

Delta decode_delta(std::span<const std::uint8_t> payload, std::size_t raw_bytes, std::size_t count,
                   std::size_t channels, std::size_t held) {
  constexpr std::string_view what = "PageDelta's values";
  require_count(what, count, std::min(held, kMaxDeltaGaussians));
  require_raw_bytes(what, raw_bytes, byte_planes_bound(count, 4) * (channels + 1));
  const Bytes raw = zstd_decompress(payload, raw_bytes, what);
  ByteReader reader(raw, what);
  Delta delta;
  delta.slots = read_slots(reader, count, held, what);
  for (std::size_t c = 0; c < channels; ++c) {
    auto& residuals = delta.residuals.emplace_back();
    residuals.reserve(count);
    for (const std::uint64_t value : reader.byte_planes(count, 4)) {
      residuals.push_back(static_cast<std::int32_t>(unzigzag(value)));
    }
  }
  reader.finish();
  return delta;
}

Payload encode_slots(std::span<const std::uint32_t> ascending) {
  Bytes raw;
  put_slots(raw, ascending);
  return finish(raw);
}

std::vector<std::uint32_t> decode_slots(std::span<const std::uint8_t> payload, std::size_t raw_bytes, std::size_t count,
                                        std::size_t held) {
  constexpr std::string_view what = "PageDelta's removals";
  require_count(what, count, held);
  require_raw_bytes(what, raw_bytes, byte_planes_bound(count, 4));
  const Bytes raw = zstd_decompress(payload, raw_bytes, what);
  ByteReader reader(raw, what);
  auto slots = read_slots(reader, count, held, what);
  reader.finish();
  return slots;
}

Payload encode_ids(std::span<const std::uint64_t> ids) {
  std::vector<std::uint64_t> differences;
  differences.reserve(ids.size());
  std::uint64_t before = 0;
  for (const std::uint64_t id : ids) {
    differences.push_back(zigzag(static_cast<std::int64_t>(id - before)));
    before = id;
  }
  Bytes raw;
  put_byte_planes(raw, differences);
  return finish(raw);
}

std::vector<std::uint64_t> decode_ids(std::span<const std::uint8_t> payload, std::size_t raw_bytes, std::size_t count) {
  constexpr std::string_view what = "ids";
  require_count(what, count, kMaxGaussians);
  require_raw_bytes(what, raw_bytes, byte_planes_bound(count, 8));
  const Bytes raw = zstd_decompress(payload, raw_bytes, what);
  ByteReader reader(raw, what);
  std::vector<std::uint64_t> ids = reader.byte_planes(count, 8);
  reader.finish();
  std::uint64_t before = 0;
  for (std::uint64_t& id : ids) id = before += static_cast<std::uint64_t>(unzigzag(id));
  return ids;
}

Payload encode_slot_ids(const SlotIds& change) {
  Bytes raw;
  put_slots(raw, change.slots);
  put_byte_planes(raw, std::vector<std::uint64_t>(change.ids.begin(), change.ids.end()));
  return finish(raw);
}

SlotIds decode_slot_ids(std::span<const std::uint8_t> payload, std::size_t raw_bytes, std::size_t count,
                        std::size_t held) {
  constexpr std::string_view what = "PageDelta's objects";
  require_count(what, count, held);
  require_raw_bytes(what, raw_bytes, 2 * byte_planes_bound(count, 4));
  const Bytes raw = zstd_decompress(payload, raw_bytes, what);
  ByteReader reader(raw, what);
  SlotIds change;
  change.slots = read_slots(reader, count, held, what);
  for (const std::uint64_t id : reader.byte_planes(count, 4)) change.ids.push_back(static_cast<std::uint32_t>(id));
  reader.finish();
  return change;
}

Payload encode_slot_values(const SlotValues& change) {
  Bytes raw;
  put_slots(raw, change.slots);
  raw.insert(raw.end(), change.values.begin(), change.values.end());
  return finish(raw);
}

SlotValues decode_slot_values(std::span<const std::uint8_t> payload, std::size_t raw_bytes, std::size_t count,
                              std::size_t held) {
  constexpr std::string_view what = "LightVisibility";
  require_count(what, count, held);
  require_raw_bytes(what, raw_bytes, byte_planes_bound(count, 4) + count);
  const Bytes raw = zstd_decompress(payload, raw_bytes, what);
  ByteReader reader(raw, what);
  SlotValues change;
  change.slots = read_slots(reader, count, held, what);
  change.values.reserve(count);
  for (std::size_t i = 0; i < count; ++i) change.values.push_back(static_cast<std::uint8_t>(reader.low_bytes(1)));
  reader.finish();
  return change;
}

}  // namespace splatbus::stream
