#pragma once

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "stream/bytes.h"
#include "stream/quantized_scene.h"

// What the codecs of a scene's parts share.
namespace splatbus::stream::scene_parts {

inline constexpr std::string_view kWhat = "Scene";
inline constexpr unsigned kAppears = 1, kPosition = 2;  // parts of a source, and of an object

[[noreturn]] inline void refuse(const std::string& why) {
  throw StreamError(fmt::format("{}: {}", kWhat, why));
}

inline void put_varint(Bytes& out, std::uint64_t value) {
  for (; value >= 0x80; value >>= 7) out.push_back(static_cast<std::uint8_t>(value | 0x80));
  out.push_back(static_cast<std::uint8_t>(value));
}

inline void put_low_bytes(Bytes& out, std::uint64_t value, int count) {
  for (int i = 0; i < count; ++i) out.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
}

template <std::size_t N>
void put(Bytes& out, const SharedExponent<N>& shared, const SharedExponent<N>& before) {
  out.push_back(static_cast<std::uint8_t>(shared.exponent));
  for (std::size_t i = 0; i < N; ++i) put_varint(out, zigzag(shared.mantissa[i] - before.mantissa[i]));
}

inline std::int16_t read_i16(ByteReader& reader) {
  return static_cast<std::int16_t>(reader.low_bytes(2));
}

template <std::size_t N>
void read(ByteReader& reader, SharedExponent<N>& shared, const char* field) {
  shared.exponent = static_cast<std::int8_t>(reader.low_bytes(1));
  for (std::int16_t& mantissa : shared.mantissa) {
    const std::int64_t change = unzigzag(reader.varint());
    if (std::abs(change / 2) > kMaxMantissa || std::abs(mantissa + change) > kMaxMantissa) {
      refuse(fmt::format("{} is out of bounds", field));
    }
    mantissa = static_cast<std::int16_t>(mantissa + change);
  }
}

/// Ids ascend: each is written as what it is beyond the one before and one more.
class Ids {
 public:
  void put(Bytes& out, std::uint32_t id) {
    put_varint(out, id - next_);
    next_ = std::uint64_t{id} + 1;
  }
  std::uint32_t read(ByteReader& reader) {
    const std::uint64_t gap = reader.varint();
    if (gap > 0xFFFFFFFFU || next_ + gap > 0xFFFFFFFFU) refuse("an id above 32 bits");
    const auto id = static_cast<std::uint32_t>(next_ + gap);
    next_ = std::uint64_t{id} + 1;
    return id;
  }

 private:
  std::uint64_t next_ = 0;
};

/// What two lists by ascending id differ in.
template <class T>
struct Difference {
  struct Changed {
    const T *now, *before;  ///< `before` null: it appears
  };
  std::vector<std::uint32_t> vanished;
  std::vector<Changed> changed;

  Difference(const std::vector<T>& now, const std::vector<T>& before) {
    auto old = before.begin();
    for (const T& item : now) {
      for (; old != before.end() && old->id < item.id; ++old) vanished.push_back(old->id);
      const bool known = old != before.end() && old->id == item.id;
      if (!known || item != *old) changed.push_back({&item, known ? &*old : nullptr});
      if (known) ++old;
    }
    for (; old != before.end(); ++old) vanished.push_back(old->id);
  }
};

inline void put_ids(Bytes& out, const std::vector<std::uint32_t>& ids) {
  put_varint(out, ids.size());
  for (Ids gaps; const std::uint32_t id : ids) gaps.put(out, id);
}

/// Takes out of `items`, which are by ascending id, those that vanish.
template <class T>
void read_vanished(ByteReader& reader, std::vector<T>& items, const char* what) {
  const std::uint64_t vanished = reader.varint();
  if (vanished > items.size()) refuse(fmt::format("{} {}s vanish of {}", vanished, what, items.size()));
  if (vanished == 0) return;
  std::vector<std::uint32_t> gone(vanished);
  for (Ids ids; std::uint32_t & id : gone) id = ids.read(reader);
  auto next = gone.begin();
  std::erase_if(items, [&](const T& item) {
    const bool is_gone = next != gone.end() && *next == item.id;
    if (is_gone) ++next;
    return is_gone;
  });
  if (next != gone.end()) refuse(fmt::format("{} {} vanishes, but is not there", what, *next));
}

/// Reads how many there are that appear or change, and for each its id and parts; `read` reads the parts into an item,
/// which is as it was, or has its id only.
template <class T, class Read>
void read_changed(ByteReader& reader, std::vector<T>& items, std::size_t most, const char* what, Read&& read) {
  const std::uint64_t changed = reader.varint();
  if (changed > most) refuse(fmt::format("{} {}s, at most {}", changed, what, most));
  if (changed == 0) return;
  std::vector<T> out;
  out.reserve(items.size() + std::min<std::size_t>(changed, reader.left()));
  auto old = items.begin();
  Ids ids;
  for (std::uint64_t i = 0; i < changed; ++i) {
    const std::uint32_t id = ids.read(reader);
    for (; old != items.end() && old->id < id; ++old) out.push_back(*old);
    const auto parts = static_cast<unsigned>(reader.low_bytes(1));
    const bool appears = (parts & kAppears) != 0, there = old != items.end() && old->id == id;
    if (parts == 0) refuse(fmt::format("{} {}: parts 0", what, id));
    if (appears == there) {
      refuse(
          fmt::format("{} {} {}", what, id, appears ? "appears, but is already there" : "changes, but is not there"));
    }
    T item{};
    if (there) item = *old++;
    item.id = id;
    read(item, parts);
    out.push_back(item);
  }
  out.insert(out.end(), old, items.end());
  if (out.size() > most) refuse(fmt::format("{} {}s, at most {}", out.size(), what, most));
  items = std::move(out);
}

inline void put_position(Bytes& out, const std::array<std::int64_t, 3>& position,
                         const std::array<std::int64_t, 3>& before) {
  for (std::size_t axis = 0; axis < 3; ++axis) put_varint(out, zigzag(position[axis] - before[axis]));
}

inline void read_position(ByteReader& reader, std::array<std::int64_t, 3>& held, const char* what, std::uint32_t id) {
  for (std::int64_t& position : held) {
    const std::int64_t change = unzigzag(reader.varint());
    if (std::abs(change / 2) > kMaxPositionSteps || std::abs(position + change) > kMaxPositionSteps) {
      refuse(fmt::format("{} {}: its position is out of bounds", what, id));
    }
    position += change;
  }
}

/// `held` plus a change, within a bound on both sides.
inline std::int32_t read_steps(ByteReader& reader, std::int32_t held, std::int32_t most, const std::string& what) {
  const std::int64_t change = unzigzag(reader.varint());
  if (std::abs(change / 2) > most || std::abs(held + change) > most) refuse(what + " is out of bounds");
  return static_cast<std::int32_t>(held + change);
}

inline void put_direction(Bytes& out, const std::array<std::int16_t, 2>& direction) {
  for (const std::int16_t e : direction) put_low_bytes(out, static_cast<std::uint16_t>(e), 2);
}

inline void read_direction(ByteReader& reader, std::array<std::int16_t, 2>& direction) {
  for (std::int16_t& e : direction) e = read_i16(reader);
}

}  // namespace splatbus::stream::scene_parts
