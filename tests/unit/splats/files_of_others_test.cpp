// What another program made of Gaussians that we know (tests/golden/splats/README.md).
#include <gtest/gtest.h>
#include <zlib.h>

#include <cmath>
#include <fstream>
#include <iterator>
#include <sstream>
#include <string>

#include "splats/file.h"

namespace splatbus::splats {
namespace {

std::string path_of(const std::string& name) {
  return std::string(SPLATBUS_SOURCE_DIR "/tests/golden/splats/") + name;
}

std::string bytes_of(const std::string& name) {
  std::ifstream file(path_of(name), std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

std::string gunzip(std::string packed) {
  z_stream state{};
  EXPECT_EQ(inflateInit2(&state, 16 + MAX_WBITS), Z_OK);
  std::string plain(std::size_t{1} << 16, '\0');
  state.next_in = reinterpret_cast<Bytef*>(packed.data());
  state.avail_in = static_cast<uInt>(packed.size());
  state.next_out = reinterpret_cast<Bytef*>(plain.data());
  state.avail_out = static_cast<uInt>(plain.size());
  EXPECT_EQ(inflate(&state, Z_FINISH), Z_STREAM_END);
  plain.resize(state.total_out);
  inflateEnd(&state);
  return plain;
}

TEST(FilesOfOthers, AnotherProgramsPlyHoldsTheSame) {
  const SplatFile given = read_file(path_of("given.ply")), theirs = read_file(path_of("splat_transform.ply"));
  ASSERT_EQ(given.gaussians.count(), 12U);
  EXPECT_TRUE(given.mip);
  EXPECT_TRUE(theirs.mip);
  EXPECT_EQ(theirs.gaussians.layout(), given.gaussians.layout());
  EXPECT_EQ(theirs.gaussians.parameters, given.gaussians.parameters);
}

TEST(FilesOfOthers, TheReferencesSpzIsReadWithinItsSteps) {
  const GaussiansBuffer given = read_file(path_of("given.ply")).gaussians;
  for (const char* name : {"splat_transform4.spz", "splat_transform3.spz"}) {
    const SplatFile file = read_file(path_of(name), Axes::Turn);
    EXPECT_TRUE(file.mip) << name;
    ASSERT_EQ(file.gaussians.count(), 12U) << name;
    ASSERT_EQ(file.gaussians.layout(), given.layout()) << name;
    for (std::size_t i = 0; i < 12; ++i) {
      const Splat theirs = load(file.gaussians.view(), i), ours = load(given.view(), i);
      EXPECT_GE(std::abs(glm::dot(theirs.rotation, ours.rotation)), 1 - 2e-6F);
      EXPECT_NEAR(1 / (1 + std::exp(-theirs.opacity_logit)), 1 / (1 + std::exp(-ours.opacity_logit)), 0.501 / 255);
      for (int c = 0; c < 3; ++c) {
        EXPECT_NEAR(theirs.mean[c], ours.mean[c], 0.51 / 4096);
        EXPECT_NEAR(theirs.log_scale[c], ours.log_scale[c], 0.501 / 16);
        EXPECT_NEAR(theirs.sh[0][c], ours.sh[0][c], 0.501 / 255 / 0.15);
        for (std::size_t k = 1; k < 16; ++k) {
          EXPECT_NEAR(theirs.sh[k][c], ours.sh[k][c], (k < 4 ? 4.51 : 8.51) / 128) << k;
        }
      }
    }
  }
}

TEST(FilesOfOthers, OurSpzHasTheReferencesBytes) {
  const SplatFile given = read_file(path_of("given.ply"));
  std::ostringstream ours;
  write(ours, Format::Spz, BakedModel(given.gaussians.view(), {}), {.axes = Axes::Turn, .spz_version = 3});
  EXPECT_EQ(gunzip(ours.str()), gunzip(bytes_of("splat_transform3.spz")));
}

}  // namespace
}  // namespace splatbus::splats
