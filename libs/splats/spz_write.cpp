#include <fmt/format.h>
#include <zlib.h>
#include <zstd.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <stdexcept>
#include <vector>

#include "splats/spz.h"
#include "splats/spz_layout.h"

namespace splatbus::splats {

namespace {

using Bytes = std::vector<std::uint8_t>;

constexpr int kZstdLevel = 12;
constexpr int kWrittenFractionalBits = 12;
constexpr float kMaxPosition = 8388607;  // of 24 bits with sign
/// Steps of SH coefficients, of the 256 over [-1, 1]: fewer bits than there is room for, so that streams pack better.
constexpr int kStepOfDegree1 = 8, kStepOfRest = 16;

std::uint8_t to_byte(float value) {
  return static_cast<std::uint8_t>(std::clamp(std::round(value), 0.0F, 255.0F));
}

std::uint8_t sh_byte(float value, int step) {
  const auto near = static_cast<int>(std::lround(std::clamp(value, -2.0F, 2.0F) * 128)) + 128;
  return static_cast<std::uint8_t>(std::clamp((near + step / 2) / step * step, 0, 255));
}

/// The index of the largest component in 2 bits, then a sign and 9 bits of each other one, x y z w.
std::uint32_t smallest_three(const glm::quat& rotation) {
  const std::array<float, 4> q = {rotation.x, rotation.y, rotation.z, rotation.w};
  const auto smaller = [](float a, float b) { return std::abs(a) < std::abs(b); };
  const auto largest = static_cast<std::size_t>(std::max_element(q.begin(), q.end(), smaller) - q.begin());
  auto packed = static_cast<std::uint32_t>(largest);
  for (std::size_t k = 0; k < 4; ++k) {
    if (k == largest) continue;
    const bool negative = (q[k] < 0) != (q[largest] < 0);
    const auto magnitude =
        static_cast<std::uint32_t>(std::lround(511 * std::min(std::abs(q[k]) * std::sqrt(2.0F), 1.0F)));
    packed = packed << 10U | (negative ? 1U << 9U : 0U) | magnitude;
  }
  return packed;
}

int fractional_bits(const BakedModel& model) {
  float farthest = 0;
  for (std::size_t i = 0; i < model.count(); ++i) {
    const glm::vec3 mean = glm::abs(model[i].mean);
    farthest = std::max({farthest, mean.x, mean.y, mean.z});
  }
  int bits = kWrittenFractionalBits;
  while (bits > 0 && std::ldexp(farthest, bits) > kMaxPosition) --bits;
  return bits;
}

std::array<Bytes, spz::kAttributes> pack(const BakedModel& model, bool turn, int bits) {
  std::array<Bytes, spz::kAttributes> streams;
  const auto sizes = spz::attribute_bytes(4, model.sh_degree());
  for (std::size_t a = 0; a < streams.size(); ++a) streams[a].reserve(model.count() * sizes[a]);
  for (std::size_t i = 0; i < model.count(); ++i) {
    const Splat splat = turn ? turned(model[i]) : model[i];
    const auto put = [&](spz::Attribute attribute, std::uint32_t value, int bytes) {
      for (int b = 0; b < bytes; ++b) streams[attribute].push_back(static_cast<std::uint8_t>(value >> 8 * b));
    };
    for (int axis = 0; axis < 3; ++axis) {
      const float steps = std::clamp(std::round(std::ldexp(splat.mean[axis], bits)), -kMaxPosition, kMaxPosition);
      put(spz::kPosition, static_cast<std::uint32_t>(static_cast<std::int32_t>(steps)), 3);
      put(spz::kColor, to_byte(255 * (0.5F + spz::kColorScale * splat.sh[0][axis])), 1);
      put(spz::kScale, to_byte(16 * (splat.log_scale[axis] + 10)), 1);
    }
    put(spz::kAlpha, to_byte(255 / (1 + std::exp(-splat.opacity_logit))), 1);
    put(spz::kRotation, smallest_three(splat.rotation), 4);
    for (std::size_t k = 1; k < static_cast<std::size_t>(model.sh_coefficients()); ++k) {
      for (int c = 0; c < 3; ++c) put(spz::kSh, sh_byte(splat.sh[k][c], k < 4 ? kStepOfDegree1 : kStepOfRest), 1);
    }
  }
  return streams;
}

Bytes zstd(const Bytes& plain) {
  Bytes packed(ZSTD_compressBound(plain.size()));
  const std::size_t size = ZSTD_compress(packed.data(), packed.size(), plain.data(), plain.size(), kZstdLevel);
  if (ZSTD_isError(size) != 0) throw std::runtime_error(fmt::format("zstd: {}", ZSTD_getErrorName(size)));
  packed.resize(size);
  return packed;
}

template <class T>
void put(std::ostream& stream, const T& value) {
  stream.write(reinterpret_cast<const char*>(&value), sizeof value);
}

void put_bytes(std::ostream& stream, const Bytes& bytes) {
  stream.write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
}

/// A gzip file, piece by piece.
class GzipStream {
 public:
  explicit GzipStream(std::ostream& out) : out_(out) {
    constexpr int kGzip = 16;
    if (deflateInit2(&state_, Z_DEFAULT_COMPRESSION, Z_DEFLATED, kGzip + MAX_WBITS, 9, Z_DEFAULT_STRATEGY) != Z_OK) {
      throw std::runtime_error("zlib: no stream");
    }
  }
  ~GzipStream() { deflateEnd(&state_); }
  GzipStream(const GzipStream&) = delete;
  GzipStream& operator=(const GzipStream&) = delete;

  void write(const void* data, std::size_t bytes, bool last = false) {
    const auto* from = static_cast<const Bytef*>(data);
    do {
      const std::size_t piece = std::min<std::size_t>(bytes, 1U << 30U);
      state_.next_in = const_cast<Bytef*>(from);
      state_.avail_in = static_cast<uInt>(piece);
      from += piece;
      bytes -= piece;
      do {
        state_.next_out = buffer_.data();
        state_.avail_out = static_cast<uInt>(buffer_.size());
        deflate(&state_, last && bytes == 0 ? Z_FINISH : Z_NO_FLUSH);
        out_.write(reinterpret_cast<const char*>(buffer_.data()),
                   static_cast<std::streamsize>(buffer_.size() - state_.avail_out));
      } while (state_.avail_out == 0);
    } while (bytes > 0);
  }

 private:
  std::ostream& out_;
  z_stream state_{};
  std::array<Bytef, std::size_t{1} << 16U> buffer_{};
};

}  // namespace

void write_spz(std::ostream& stream, const BakedModel& model, const WriteOptions& options) {
  if (options.spz_version != 3 && options.spz_version != 4) {
    throw std::runtime_error(fmt::format("version {} of SPZ cannot be written; 3 and 4 can", options.spz_version));
  }
  if (model.count() == 0) throw std::runtime_error("an .spz file cannot hold a model without Gaussians");
  spz::Header header{.version = static_cast<std::uint32_t>(options.spz_version),
                     .count = static_cast<std::uint32_t>(model.count()),
                     .sh_degree = static_cast<std::uint8_t>(model.sh_degree()),
                     .fractional_bits = static_cast<std::uint8_t>(fractional_bits(model)),
                     .flags = options.mip ? std::uint8_t{spz::kAntialiased} : std::uint8_t{0}};
  const auto streams = pack(model, options.axes == Axes::Turn, header.fractional_bits);
  if (options.spz_version == 3) {
    GzipStream gzip(stream);
    gzip.write(&header, sizeof header);
    for (const Bytes& attribute : streams) gzip.write(attribute.data(), attribute.size());
    gzip.write(nullptr, 0, true);
    return;
  }
  std::vector<Bytes> packed;
  std::vector<std::uint64_t> toc;
  for (const Bytes& attribute : streams) {
    if (attribute.empty()) continue;
    packed.push_back(zstd(attribute));
    toc.insert(toc.end(), {packed.back().size(), attribute.size()});
  }
  header.streams = static_cast<std::uint8_t>(packed.size());
  put(stream, header);
  put(stream, spz::Header4{});
  for (const std::uint64_t size : toc) put(stream, size);
  for (const Bytes& attribute : packed) put_bytes(stream, attribute);
}

}  // namespace splatbus::splats
