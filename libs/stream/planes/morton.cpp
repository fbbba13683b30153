#include "stream/planes/morton.h"

namespace splatbus::stream::planes {

namespace {

/// What each value of a byte comes to, of what each of its bits does.
void put_sums(std::array<std::uint64_t, 256>& of_byte, const std::uint64_t* of_bit) {
  of_byte[0] = 0;
  for (std::size_t bit = 0; bit < 8; ++bit) {
    const std::size_t half = std::size_t{1} << bit;
    for (std::size_t value = 0; value < half; ++value) of_byte[half + value] = of_byte[value] | of_bit[bit];
  }
}

}  // namespace

Interleaver::Interleaver(const std::array<int, 3>& bits) {
  std::array<std::array<std::uint64_t, 24>, 3> to{};
  int next = 0;
  for (int bit = 0; bit < kMaxCellBits; ++bit) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      if (bit < bits[axis]) to[axis][static_cast<std::size_t>(bit)] = std::uint64_t{1} << next++;
    }
  }
  for (std::size_t axis = 0; axis < 3; ++axis) {
    for (std::size_t byte = 0; byte < 3; ++byte) put_sums(part_[axis][byte], to[axis].data() + 8 * byte);
  }
}

Deinterleaver::Deinterleaver(const std::array<int, 3>& bits) {
  std::array<std::uint64_t, 64> to{};
  std::size_t next = 0;
  for (int bit = 0; bit < kMaxCellBits; ++bit) {
    for (int axis = 0; axis < 3; ++axis) {
      if (bit < bits[static_cast<std::size_t>(axis)]) to[next++] = std::uint64_t{1} << (kMaxCellBits * axis + bit);
    }
  }
  for (std::size_t byte = 0; byte < 8; ++byte) put_sums(part_[byte], to.data() + 8 * byte);
}

}  // namespace splatbus::stream::planes
