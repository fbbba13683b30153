#include "stream/bytes.h"

#include <fmt/format.h>
#include <zstd.h>

#include <memory>
#include <new>

namespace splatbus::stream {

namespace {

struct FreeCompressor {
  void operator()(ZSTD_CCtx* context) const { ZSTD_freeCCtx(context); }
};

}  // namespace

Bytes zstd_compress(std::span<const std::uint8_t> raw, int level) {
  // Its tables are larger than most of what is compressed, and cost more to make.
  thread_local const std::unique_ptr<ZSTD_CCtx, FreeCompressor> context(ZSTD_createCCtx());
  if (!context) throw std::bad_alloc();
  Bytes out(ZSTD_compressBound(raw.size()));
  const std::size_t size = ZSTD_compressCCtx(context.get(), out.data(), out.size(), raw.data(), raw.size(), level);
  if (ZSTD_isError(size)) throw StreamError(fmt::format("zstd: {}", ZSTD_getErrorName(size)));
  out.resize(size);
  return out;
}

Bytes zstd_decompress(std::span<const std::uint8_t> payload, std::size_t raw_bytes, std::string_view what) {
  const unsigned long long said = ZSTD_getFrameContentSize(payload.data(), payload.size());
  if (said == ZSTD_CONTENTSIZE_ERROR || said == ZSTD_CONTENTSIZE_UNKNOWN || said != raw_bytes) {
    throw StreamError(fmt::format("{}: payload is not a Zstandard frame of {} bytes", what, raw_bytes));
  }
  Bytes out(raw_bytes);
  const std::size_t size = ZSTD_decompress(out.data(), out.size(), payload.data(), payload.size());
  if (ZSTD_isError(size)) throw StreamError(fmt::format("{}: Zstandard: {}", what, ZSTD_getErrorName(size)));
  if (size != raw_bytes) throw StreamError(fmt::format("{}: {} bytes instead of {}", what, size, raw_bytes));
  return out;
}

void put_byte_planes(Bytes& out, std::span<const std::uint64_t> values) {
  std::uint64_t all = 0;
  for (const std::uint64_t value : values) all |= value;
  std::size_t width = 1;
  while (width < 8 && (all >> (8 * width)) != 0) ++width;
  std::size_t to = out.size();
  out.resize(to + byte_planes_bound(values.size(), width));
  out[to++] = static_cast<std::uint8_t>(width);
  for (std::size_t byte = 0; byte < width; ++byte) {
    for (const std::uint64_t value : values) out[to++] = static_cast<std::uint8_t>(value >> (8 * byte));
  }
}

void ByteReader::require(std::size_t bytes) const {
  if (bytes_.size() - at_ < bytes) {
    throw StreamError(
        fmt::format("{}: ends after {} of its bytes, {} more were announced", what_, bytes_.size(), bytes));
  }
}

std::uint64_t ByteReader::low_bytes(std::size_t count) {
  require(count);
  std::uint64_t value = 0;
  for (std::size_t i = 0; i < count; ++i) value |= static_cast<std::uint64_t>(bytes_[at_++]) << (8 * i);
  return value;
}

std::uint64_t ByteReader::varint() {
  std::uint64_t value = 0;
  for (int shift = 0; shift < 64; shift += 7) {
    const std::uint64_t byte = low_bytes(1);
    if (shift == 63 && byte > 1) break;
    value |= (byte & 0x7F) << shift;
    if (byte < 0x80) return value;
  }
  throw StreamError(fmt::format("{}: a number of more than 64 bits", what_));
}

std::vector<std::uint64_t> ByteReader::byte_planes(std::size_t count, std::size_t max_width) {
  require(1);
  const std::size_t width = bytes_[at_++];
  if (width < 1 || width > max_width) {
    throw StreamError(fmt::format("{}: values of {} bytes, at most {} are allowed", what_, width, max_width));
  }
  if (count > (bytes_.size() - at_) / width) require(bytes_.size() - at_ + 1);
  std::vector<std::uint64_t> values(count);
  for (std::size_t byte = 0; byte < width; ++byte) {
    for (std::size_t i = 0; i < count; ++i) values[i] |= static_cast<std::uint64_t>(bytes_[at_++]) << (8 * byte);
  }
  return values;
}

void ByteReader::finish() const {
  if (at_ != bytes_.size()) throw StreamError(fmt::format("{}: {} bytes too many", what_, bytes_.size() - at_));
}

}  // namespace splatbus::stream
