#include <fmt/format.h>
#include <zlib.h>
#include <zstd.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <memory>
#include <stdexcept>
#include <vector>

#include "splats/spz.h"
#include "splats/spz_layout.h"

namespace splatbus::splats {

namespace {

using Bytes = std::vector<std::uint8_t>;
using Attributes = std::array<Bytes, spz::kAttributes>;

constexpr std::size_t kFreeBytes = std::size_t{1} << 20, kMaxRatio = 64;
constexpr int kMaxFractionalBits = 24;
constexpr int kGzipMagic = 0x1F;

class Reader {
 public:
  Reader(Bytes file, const std::string& name) : file_(std::move(file)), name_(name) {}

  /// Fills header() and returns the attributes, each of the size that the header gives it.
  Attributes read() {
    if (file_.size() >= 2 && file_[0] == kGzipMagic && file_[1] == 0x8B) return read_gzip();
    return read_zstd();
  }
  [[nodiscard]] const spz::Header& header() const { return header_; }

 private:
  [[noreturn]] void fail(const std::string& what) const {
    throw std::runtime_error(fmt::format("{}: {}", name_, what));
  }

  /// Of each attribute, once the header is known to be one.
  std::array<std::size_t, spz::kAttributes> check_header(std::uint32_t first_version, std::uint32_t last_version) {
    if (header_.magic != spz::kMagic) fail("header: this is not an SPZ file: it does not begin with \"NGSP\"");
    if (header_.version < first_version || header_.version > last_version) {
      fail(fmt::format("header: version {} in a file of versions {} to {}", header_.version, first_version,
                       last_version));
    }
    if (header_.sh_degree > spz::kMaxDegree) fail(fmt::format("header: SH of degree {}", header_.sh_degree));
    if (header_.fractional_bits > kMaxFractionalBits) {
      fail(fmt::format("header: {} fractional bits, of 24", header_.fractional_bits));
    }
    auto sizes = spz::attribute_bytes(header_.version, header_.sh_degree);
    std::size_t total = 0;
    for (std::size_t& size : sizes) total += size *= header_.count;
    if (total > std::max(kFreeBytes, kMaxRatio * file_.size())) {
      fail(fmt::format("header: {} Gaussians of {} bytes are announced, in a file of {}", header_.count,
                       total / header_.count, file_.size()));
    }
    return sizes;
  }

  Attributes read_zstd() {
    spz::Header4 more;
    if (file_.size() < sizeof header_ + sizeof more) fail("header: the file ends inside it");
    std::memcpy(&header_, file_.data(), sizeof header_);
    std::memcpy(&more, file_.data() + sizeof header_, sizeof more);
    const auto sizes = check_header(4, 4);
    const auto wanted =
        static_cast<std::size_t>(std::count_if(sizes.begin(), sizes.end(), [](auto s) { return s > 0; }));
    if (header_.streams != wanted) fail(fmt::format("header: {} streams, not {}", header_.streams, wanted));
    const std::size_t toc_bytes = 16 * wanted;
    if (more.toc_offset < sizeof header_ + sizeof more || more.toc_offset > file_.size() ||
        file_.size() - more.toc_offset < toc_bytes) {
      fail(fmt::format("header: a table of contents at byte {} of {}", more.toc_offset, file_.size()));
    }
    Attributes out;
    std::size_t entry = more.toc_offset, at = entry + toc_bytes;
    for (std::size_t a = 0; a < out.size(); ++a) {
      if (sizes[a] == 0) continue;
      std::array<std::uint64_t, 2> stated{};  // packed, plain
      std::memcpy(stated.data(), file_.data() + entry, sizeof stated);
      if (stated[1] != sizes[a]) {
        fail(fmt::format("byte {}: a stream of {} bytes, where {} Gaussians have {}", entry, stated[1], header_.count,
                         sizes[a]));
      }
      if (stated[0] > file_.size() - at) {
        fail(fmt::format("byte {}: a stream of {} bytes, but {} follow", at, stated[0], file_.size() - at));
      }
      out[a].resize(sizes[a]);
      const std::size_t size = ZSTD_decompress(out[a].data(), sizes[a], file_.data() + at, stated[0]);
      if (ZSTD_isError(size) != 0) fail(fmt::format("byte {}: zstd: {}", at, ZSTD_getErrorName(size)));
      if (size != sizes[a]) fail(fmt::format("byte {}: a stream unpacks to {} bytes, not {}", at, size, sizes[a]));
      entry += sizeof stated;
      at += stated[0];
    }
    return out;
  }

  Attributes read_gzip() {
    z_stream state{};
    constexpr int kGzip = 16;
    if (inflateInit2(&state, kGzip + MAX_WBITS) != Z_OK) fail("zlib: no stream");
    const std::unique_ptr<z_stream, int (*)(z_stream*)> ender(&state, inflateEnd);
    std::size_t taken = 0;  // of the file
    int status = Z_OK;
    const auto unpack = [&](std::uint8_t* to, std::size_t bytes) {
      std::size_t done = 0;
      while (done < bytes && status == Z_OK) {
        constexpr std::size_t kPiece = std::size_t{1} << 30;
        const std::size_t in = std::min(file_.size() - taken, kPiece), out = std::min(bytes - done, kPiece);
        state.next_in = file_.data() + taken;
        state.avail_in = static_cast<uInt>(in);
        state.next_out = to + done;
        state.avail_out = static_cast<uInt>(out);
        status = inflate(&state, Z_NO_FLUSH);
        taken += in - state.avail_in;
        done += out - state.avail_out;
      }
      return done;
    };
    const auto unpack_all = [&](std::uint8_t* to, std::size_t bytes, const char* what) {
      if (unpack(to, bytes) == bytes) return;
      fail(fmt::format("byte {}: gzip: {} {}", taken, what,
                       status == Z_STREAM_END || taken == file_.size() ? "ends too early" : "is damaged"));
    };
    unpack_all(reinterpret_cast<std::uint8_t*>(&header_), sizeof header_, "the header");
    const auto sizes = check_header(2, 3);
    Attributes out;
    for (std::size_t a = 0; a < out.size(); ++a) {
      out[a].resize(sizes[a]);
      unpack_all(out[a].data(), sizes[a], "an attribute");
    }
    // Extensions, of which we know none, and gzip's own sum.
    Bytes rest(kFreeBytes);
    unpack(rest.data(), rest.size());
    if (status != Z_STREAM_END) fail(fmt::format("byte {}: gzip: the file does not end where it should", taken));
    return out;
  }

  Bytes file_;
  const std::string& name_;
  spz::Header header_;
};

float signed_24(const std::uint8_t* bytes) {
  const auto word = static_cast<std::uint32_t>(bytes[0] << 8 | bytes[1] << 16) | static_cast<std::uint32_t>(bytes[2])
                                                                                     << 24U;
  return static_cast<float>(static_cast<std::int32_t>(word) >> 8);
}

glm::quat first_three(const std::uint8_t* bytes) {
  const glm::vec3 v = glm::vec3(bytes[0], bytes[1], bytes[2]) / 127.5F - 1.0F;
  return glm::normalize(glm::quat(std::sqrt(std::max(0.0F, 1 - glm::dot(v, v))), v.x, v.y, v.z));
}

glm::quat smallest_three(const std::uint8_t* bytes) {
  std::uint32_t packed = 0;
  std::memcpy(&packed, bytes, sizeof packed);
  const std::size_t largest = packed >> 30U;
  std::array<float, 4> q{};  // x y z w
  float rest = 1;
  for (std::size_t k = 4; k-- > 0;) {
    if (k == largest) continue;
    q[k] = static_cast<float>(packed & 511U) / (511 * std::sqrt(2.0F)) * ((packed & 512U) != 0 ? -1.0F : 1.0F);
    rest -= q[k] * q[k];
    packed >>= 10U;
  }
  q[largest] = std::sqrt(std::max(0.0F, rest));
  return glm::normalize(glm::quat(q[3], q[0], q[1], q[2]));
}

/// The ends of the scale stand for no logit that is a number: for a quarter of a step inside.
float logit_of(std::uint8_t alpha) {
  const float opacity = std::clamp(static_cast<float>(alpha), 0.25F, 254.75F) / 255;
  return std::log(opacity / (1 - opacity));
}

Splat unpack(const Attributes& attributes, const spz::Header& header, std::size_t i, int coefficients) {
  const auto sizes = spz::attribute_bytes(header.version, header.sh_degree);
  const auto at = [&](spz::Attribute attribute) { return attributes[attribute].data() + i * sizes[attribute]; };
  Splat splat;
  for (int axis = 0; axis < 3; ++axis) {
    splat.mean[axis] = std::ldexp(signed_24(at(spz::kPosition) + std::ptrdiff_t{3} * axis), -header.fractional_bits);
    splat.log_scale[axis] = static_cast<float>(at(spz::kScale)[axis]) / 16 - 10;
    splat.sh[0][axis] = (static_cast<float>(at(spz::kColor)[axis]) / 255 - 0.5F) / spz::kColorScale;
  }
  splat.opacity_logit = logit_of(*at(spz::kAlpha));
  splat.rotation = header.version >= 3 ? smallest_three(at(spz::kRotation)) : first_three(at(spz::kRotation));
  for (int k = 1; k < coefficients; ++k) {
    for (int c = 0; c < 3; ++c) {
      splat.sh[static_cast<std::size_t>(k)][c] = (static_cast<float>(at(spz::kSh)[3 * (k - 1) + c]) - 128) / 128;
    }
  }
  return splat;
}

}  // namespace

bool is_spz(int first_byte) {
  return first_byte == kGzipMagic || first_byte == 'N';
}

SplatFile read_spz(std::istream& stream, const std::string& name, Axes axes) {
  stream.seekg(0, std::ios::end);
  const std::streamoff size = stream.tellg();
  if (!stream || size < 0) throw std::runtime_error(fmt::format("{}: not a regular file", name));
  stream.seekg(0);
  Bytes file(static_cast<std::size_t>(size));
  if (!stream.read(reinterpret_cast<char*>(file.data()), size)) {
    throw std::runtime_error(fmt::format("{}: the file cannot be read", name));
  }
  Reader reader(std::move(file), name);
  const Attributes attributes = reader.read();
  const spz::Header& header = reader.header();
  const ParameterLayout layout{Appearance::Radiance, std::min<int>(header.sh_degree, kMaxShDegree)};
  SplatFile out{GaussiansBuffer(layout, header.count), (header.flags & spz::kAntialiased) != 0};
  for (std::size_t i = 0; i < out.gaussians.count(); ++i) {
    const Splat splat = unpack(attributes, header, i, layout.sh_coefficients());
    store(axes == Axes::Turn ? turned(splat) : splat, out.gaussians, i);
  }
  return out;
}

}  // namespace splatbus::splats
