#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <stdexcept>
#include <string_view>
#include <vector>

namespace splatbus::stream {

/// A packet or payload that cannot be what it says; what() names the packet and the field. Whoever throws it has
/// changed nothing.
class StreamError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

using Bytes = std::vector<std::uint8_t>;

/// Of a tick's packets: 4 to 6 % fewer bytes than level 3, for a millisecond.
inline constexpr int kZstdLevel = 9;

/// One Zstandard frame that says its content's size.
[[nodiscard]] Bytes zstd_compress(std::span<const std::uint8_t> raw, int level = kZstdLevel);

/// `raw_bytes` is what the packet says; the caller has bounded it. Throws StreamError, naming `what`, unless the
/// payload is one frame of exactly that content size.
[[nodiscard]] Bytes zstd_decompress(std::span<const std::uint8_t> payload, std::size_t raw_bytes,
                                    std::string_view what);

/// Signed to unsigned so that small magnitudes are small numbers: 0, -1, 1, -2 become 0, 1, 2, 3.
[[nodiscard]] constexpr std::uint64_t zigzag(std::int64_t value) {
  return (static_cast<std::uint64_t>(value) << 1) ^ static_cast<std::uint64_t>(value >> 63);
}
[[nodiscard]] constexpr std::int64_t unzigzag(std::uint64_t value) {
  return static_cast<std::int64_t>(value >> 1) ^ -static_cast<std::int64_t>(value & 1);
}

/// Appends `values` as planes: one byte with the width in bytes (1 to 8) that the largest needs, then all lowest bytes,
/// then all second bytes, and so on.
void put_byte_planes(Bytes& out, std::span<const std::uint64_t> values);

/// Largest size of put_byte_planes for `count` values of at most `width` bytes each.
[[nodiscard]] constexpr std::size_t byte_planes_bound(std::size_t count, std::size_t width) {
  return 1 + count * width;
}

/// Reads what put_byte_planes and its like wrote. Every read is checked; a shortage throws StreamError naming `what`.
class ByteReader {
 public:
  ByteReader(std::span<const std::uint8_t> bytes, std::string_view what) : bytes_(bytes), what_(what) {}

  [[nodiscard]] std::uint32_t u32() { return static_cast<std::uint32_t>(low_bytes(4)); }
  /// The `count` (up to 8) lowest bytes of a number, lowest first.
  [[nodiscard]] std::uint64_t low_bytes(std::size_t count);
  /// Seven bits a byte, lowest first, the eighth set in all but the last (LEB128).
  [[nodiscard]] std::uint64_t varint();
  /// `count` values of at most `max_width` bytes; the count is checked against what is left before anything is
  /// allocated.
  [[nodiscard]] std::vector<std::uint64_t> byte_planes(std::size_t count, std::size_t max_width);
  [[nodiscard]] std::size_t left() const { return bytes_.size() - at_; }
  /// Throws unless everything was read.
  void finish() const;

 private:
  void require(std::size_t bytes) const;
  std::span<const std::uint8_t> bytes_;
  std::string_view what_;
  std::size_t at_ = 0;
};

}  // namespace splatbus::stream
