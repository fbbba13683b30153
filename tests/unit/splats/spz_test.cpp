#include "splats/spz.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <zlib.h>
#include <zstd.h>

#include <cmath>
#include <cstring>
#include <sstream>
#include <stdexcept>

#include "../gaussians/random.h"

namespace splatbus::splats {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::ThrowsMessage;

/// Within the format's ranges.
GaussiansBuffer random_model(std::uint32_t seed, int degree, std::size_t count) {
  test::Random random(seed);
  GaussiansBuffer model({Appearance::Radiance, degree}, count);
  for (std::size_t i = 0; i < count; ++i) {
    Splat splat;
    splat.mean = random.vector(-100, 100);
    splat.log_scale = random.vector(-9, 5);
    splat.rotation = random.rotation();
    splat.opacity_logit = random.uniform(-5, 5);
    splat.sh[0] = random.vector(-3, 3);
    for (std::size_t k = 1; k < splat.sh.size(); ++k) splat.sh[k] = random.vector(-0.9F, 0.9F);
    store(splat, model, i);
  }
  return model;
}

std::string written_spz(const GaussiansBuffer& model, const WriteOptions& options = {}) {
  std::ostringstream stream;
  write_spz(stream, BakedModel(model.view(), {}), options);
  return stream.str();
}

SplatFile read(const std::string& bytes, Axes axes = Axes::OfFormat) {
  std::istringstream stream(bytes);
  return read_spz(stream, "model.spz", axes);
}

template <class T>
T at(const std::string& bytes, std::size_t offset) {
  T value{};
  EXPECT_LE(offset + sizeof value, bytes.size());
  std::memcpy(&value, bytes.data() + offset, sizeof value);
  return value;
}

template <class T>
std::string with(std::string bytes, std::size_t offset, T value) {
  std::memcpy(bytes.data() + offset, &value, sizeof value);
  return bytes;
}

std::string gzip(const std::string& plain) {
  z_stream state{};
  EXPECT_EQ(deflateInit2(&state, 9, Z_DEFLATED, 16 + MAX_WBITS, 9, Z_DEFAULT_STRATEGY), Z_OK);
  std::string packed(deflateBound(&state, plain.size()) + 64, '\0');
  state.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(plain.data()));
  state.avail_in = static_cast<uInt>(plain.size());
  state.next_out = reinterpret_cast<Bytef*>(packed.data());
  state.avail_out = static_cast<uInt>(packed.size());
  EXPECT_EQ(deflate(&state, Z_FINISH), Z_STREAM_END);
  packed.resize(state.total_out);
  deflateEnd(&state);
  return packed;
}

std::string gunzip(const std::string& packed, std::size_t bytes) {
  z_stream state{};
  EXPECT_EQ(inflateInit2(&state, 16 + MAX_WBITS), Z_OK);
  std::string plain(bytes, '\0');
  state.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(packed.data()));
  state.avail_in = static_cast<uInt>(packed.size());
  state.next_out = reinterpret_cast<Bytef*>(plain.data());
  state.avail_out = static_cast<uInt>(plain.size());
  inflate(&state, Z_FINISH);
  plain.resize(state.total_out);
  inflateEnd(&state);
  return plain;
}

/// One Gaussian whose packed bytes are known by hand.
GaussiansBuffer one() {
  Splat splat;
  splat.mean = {1, -0.5F, 1.0F / 4096};
  splat.log_scale = {-10, -9.9375F, 0};
  splat.rotation = {0.5F, 0.5F, -0.5F, 0.5F};  // w x y z: all as large, the first of x y z w counts as largest
  splat.opacity_logit = 0;
  splat.sh[0] = {0, 10, -10};
  splat.sh[1] = {0.5F, -0.5F, 0};
  splat.sh[3] = {0.03F, -2, 2};
  GaussiansBuffer model({Appearance::Radiance, 1}, 1);
  store(splat, model, 0);
  return model;
}
// In the order of the file; written out from the format's text.
const std::string kOne = std::string("\x00\x10\x00\x00\xF8\xFF\x01\x00\x00", 9) +  // means
                         "\x80" +                                                  // opacity 127.5, rounded up
                         "\x80\xFF" + std::string(1, '\0') +                       // colours, the last two saturated
                         std::string("\x00\x01\xA0", 3) +                          // scales
                         std::string("\x69\xA5\x95\x36", 4) +                      // rotation
                         std::string("\xC0\x40\x80\x80\x80\x80\x88\x00\xFF", 9);

TEST(Spz, Version3IsTheBytesOfTheFormat) {
  const std::string packed = written_spz(one(), {.spz_version = 3});
  const std::string header("NGSP\x03\x00\x00\x00\x01\x00\x00\x00\x01\x0C\x01\x00", 16);
  EXPECT_EQ(gunzip(packed, 1000), header + kOne);
  EXPECT_EQ(gunzip(written_spz(one(), {.mip = false, .spz_version = 3}), 1000)[14], 0);
}

TEST(Spz, Version4IsTheBytesOfTheFormat) {
  const std::string packed = written_spz(one());
  EXPECT_EQ(
      packed.substr(0, 32),
      std::string("NGSP\x04\x00\x00\x00\x01\x00\x00\x00\x01\x0C\x01\x06\x20\x00\x00\x00", 20) + std::string(12, '\0'));
  std::size_t from = 32 + 6 * 16, plain_from = 0;
  for (std::size_t stream = 0; stream < 6; ++stream) {
    const auto packed_bytes = at<std::uint64_t>(packed, 32 + 16 * stream);
    const auto bytes = at<std::uint64_t>(packed, 32 + 16 * stream + 8);
    std::string plain(bytes, '\0');
    EXPECT_EQ(ZSTD_decompress(plain.data(), bytes, packed.data() + from, packed_bytes), bytes);
    EXPECT_EQ(plain, kOne.substr(plain_from, bytes)) << "stream " << stream;
    from += packed_bytes;
    plain_from += bytes;
  }
  EXPECT_EQ(from, packed.size());
  EXPECT_EQ(plain_from, kOne.size());
}

TEST(Spz, ComesBackWithinTheQuantisersSteps) {
  for (int degree = 0; degree <= 3; ++degree) {
    const GaussiansBuffer model = random_model(60 + static_cast<std::uint32_t>(degree), degree, 500);
    for (const int version : {3, 4}) {
      const SplatFile file = read(written_spz(model, {.spz_version = version}));
      EXPECT_TRUE(file.mip);
      const GaussiansBuffer& back = file.gaussians;
      ASSERT_EQ(back.layout(), model.layout());
      ASSERT_EQ(back.count(), model.count());
      for (std::size_t i = 0; i < model.count(); ++i) {
        const Splat before = load(model.view(), i), after = load(back.view(), i);
        const auto opacity = [](const Splat& splat) { return 1 / (1 + std::exp(-splat.opacity_logit)); };
        EXPECT_NEAR(opacity(after), opacity(before), 0.5001 / 255);
        // Three components within half a step each of sqrt(1/2) / 511, and what that makes of the fourth.
        EXPECT_GE(std::abs(glm::dot(after.rotation, before.rotation)), 1 - 2e-6F);
        for (int axis = 0; axis < 3; ++axis) {
          EXPECT_NEAR(after.mean[axis], before.mean[axis], 0.51 / 4096);
          EXPECT_NEAR(after.log_scale[axis], before.log_scale[axis], 0.5001 / 16);
          EXPECT_NEAR(after.sh[0][axis], before.sh[0][axis], 0.5001 / 255 / 0.15);
          for (std::size_t k = 1; k < static_cast<std::size_t>(model.layout().sh_coefficients()); ++k) {
            EXPECT_NEAR(after.sh[k][axis], before.sh[k][axis], ((k < 4 ? 4.0 : 8.0) + 0.51) / 128) << k;
          }
        }
      }
    }
  }
}

TEST(Spz, PositionsThatAreFarHaveFewerFractionalBits) {
  GaussiansBuffer model = random_model(70, 0, 3);
  model.parameters[1] = -20000;
  const std::string bytes = written_spz(model, {.mip = false});
  EXPECT_EQ(bytes[13], 8);  // 20000 * 2^8 < 2^23 < 20000 * 2^9
  const SplatFile file = read(bytes);
  EXPECT_FALSE(file.mip);
  EXPECT_EQ(file.gaussians.parameters[1], -20000);
  EXPECT_NEAR(file.gaussians.parameters[0], model.parameters[0], 0.51 / 256);
}

TEST(Spz, AxesAreOursUnlessTurned) {
  const GaussiansBuffer model = one();
  EXPECT_EQ(read(written_spz(model)).gaussians.parameters[0], 1);
  EXPECT_EQ(read(written_spz(model, {.axes = Axes::Turn})).gaussians.parameters[0], -1);
  EXPECT_EQ(read(written_spz(model), Axes::Turn).gaussians.parameters[0], -1);
  EXPECT_EQ(read(written_spz(model, {.axes = Axes::Keep}), Axes::Keep).gaussians.parameters[0], 1);
}

TEST(Spz, OpacitiesOfNothingAndAllHaveLogits) {
  GaussiansBuffer model = random_model(71, 0, 2);
  model.parameters[ParameterLayout::kOpacityLogit * model.stride()] = -30;
  model.parameters[ParameterLayout::kOpacityLogit * model.stride() + 1] = 30;
  const GaussiansBuffer back = read(written_spz(model)).gaussians;
  EXPECT_NEAR(back.view().plane(ParameterLayout::kOpacityLogit)[0], -6.9, 0.1);
  EXPECT_NEAR(back.view().plane(ParameterLayout::kOpacityLogit)[1], 6.9, 0.1);
}

TEST(Spz, ReadsVersion2) {
  std::string plain("NGSP\x02\x00\x00\x00\x01\x00\x00\x00\x00\x0C\x00\x00", 16);
  plain += kOne.substr(0, 16) + std::string("\xFF\x80\x80", 3);  // about x by half a turn, nearly
  const GaussiansBuffer back = read(gzip(plain)).gaussians;
  ASSERT_EQ(back.count(), 1U);
  const Splat splat = load(back.view(), 0);
  EXPECT_EQ(splat.mean, glm::vec3(1, -0.5F, 1.0F / 4096));
  EXPECT_NEAR(std::abs(splat.rotation.x), 1, 1e-4F);
}

TEST(Spz, LeavesOutTheFourthDegree) {
  std::string plain("NGSP\x03\x00\x00\x00\x02\x00\x00\x00\x04\x0C\x00\x00", 16);
  for (int i = 0; i < 2 * 16; ++i) plain += '\x01';
  for (int i = 0; i < 2 * 4; ++i) plain += '\x11';
  for (int i = 0; i < 2 * 72; ++i) plain += static_cast<char>(i);
  const GaussiansBuffer back = read(gzip(plain)).gaussians;
  EXPECT_EQ(back.layout().sh_degree, 3);
  EXPECT_EQ(back.view().plane(11 + 47)[1], (72 + 44 - 128) / 128.0F);
}

TEST(Spz, RefusesWhatItCannotWrite) {
  const GaussiansBuffer none({Appearance::Radiance, 0}, 0);
  EXPECT_THAT([&] { (void)written_spz(none); }, ThrowsMessage<std::runtime_error>(HasSubstr("without Gaussians")));
  EXPECT_THAT([&] { (void)written_spz(one(), {.spz_version = 2}); },
              ThrowsMessage<std::runtime_error>(HasSubstr("version 2 of SPZ cannot be written")));
}

void expect_refused(const std::string& bytes, const std::string& reason) {
  EXPECT_THAT([&] { (void)read(bytes); },
              ThrowsMessage<std::runtime_error>(AllOf(HasSubstr("model.spz: "), HasSubstr(reason))));
}

TEST(Spz, RefusesLiesOfVersion4ByPlace) {
  const std::string good = written_spz(random_model(72, 1, 20));
  ASSERT_EQ(read(good).gaussians.count(), 20U);
  expect_refused(good.substr(0, 31), "header: the file ends inside it");
  expect_refused("NGSX" + good.substr(4), "does not begin with \"NGSP\"");
  expect_refused(with<std::uint32_t>(good, 4, 3), "header: version 3 in a file of versions 4 to 4");
  expect_refused(with<std::uint32_t>(good, 8, 0xFFFFFFFF), "4294967295 Gaussians of 29 bytes are announced");
  expect_refused(with<std::uint32_t>(good, 8, 21), "a stream of 180 bytes, where 21 Gaussians have 189");
  expect_refused(with<char>(good, 12, 5), "header: SH of degree 5");
  expect_refused(with<char>(good, 12, 0), "header: 6 streams, not 5");
  expect_refused(with<char>(good, 13, 25), "header: 25 fractional bits");
  expect_refused(with<std::uint32_t>(good, 16, 31), "a table of contents at byte 31");
  expect_refused(with<std::uint32_t>(good, 16, 0xFFFFFFF0), "a table of contents at byte 4294967280");
  expect_refused(with<std::uint64_t>(good, 32, UINT64_MAX), "byte 128: a stream of 18446744073709551615 bytes, but");
  expect_refused(with<std::uint64_t>(good, 40, UINT64_MAX), "byte 32: a stream of 18446744073709551615 bytes, where");
  expect_refused(with<char>(good, 128, 0), "byte 128: zstd: ");
  expect_refused(good.substr(0, good.size() - 1), "a stream of ");
  std::string empty(20, '\0');
  empty.resize(ZSTD_compress(empty.data(), empty.size(), "", 0, 1));
  const auto first = at<std::uint64_t>(good, 32);
  expect_refused(with<std::uint64_t>(good, 32, empty.size()).substr(0, 128) + empty + good.substr(128 + first),
                 "byte 128: a stream unpacks to 0 bytes, not 180");
}

TEST(Spz, RefusesLiesOfVersion3ByPlace) {
  const std::string plain("NGSP\x03\x00\x00\x00\x01\x00\x00\x00\x01\x0C\x01\x00", 16);
  ASSERT_EQ(read(gzip(plain + kOne)).gaussians.count(), 1U);
  EXPECT_EQ(read(gzip(with<char>(plain, 14, 2) + kOne + "extension")).gaussians.count(), 1U);
  expect_refused(gzip(plain.substr(0, 10)), "gzip: the header ends too early");
  expect_refused(gzip(plain + kOne.substr(0, 28)), "gzip: an attribute ends too early");
  expect_refused(gzip(with<char>(plain, 4, 4) + kOne), "header: version 4 in a file of versions 2 to 3");
  expect_refused(gzip(with<std::uint32_t>(plain, 8, 0x7FFFFFFF) + kOne),
                 "2147483647 Gaussians of 29 bytes are announced");
  const std::string good = gzip(plain + kOne);
  expect_refused(good.substr(0, 4), "gzip: the header ends too early");
  expect_refused(good.substr(0, good.size() - 1), "gzip: the file does not end where it should");
  expect_refused(with<char>(good, good.size() - 5, 1), "gzip: the file does not end where it should");
  expect_refused(with<char>(good, 2, 0), "gzip: the header is damaged");
}

TEST(Spz, RefusesWhatUnpacksToFarMoreThanItIs) {
  // 100,000 Gaussians, 2 MB, of which the first bytes do not pack and the rest is zero.
  const auto file = [](std::size_t incompressible) {
    test::Random random(73);
    std::string plain("NGSP\x03\x00\x00\x00\xA0\x86\x01\x00\x00\x0C\x00\x00", 16);
    for (std::size_t i = 0; i < incompressible; ++i) plain += static_cast<char>(random.uniform(0, 256));
    plain.resize(16 + 20 * 100'000);
    return gzip(plain);
  };
  EXPECT_EQ(read(file(40'000)).gaussians.count(), 100'000U) << "48 times";
  expect_refused(file(25'000), "100000 Gaussians of 20 bytes are announced, in a file of");
}

}  // namespace
}  // namespace splatbus::splats
