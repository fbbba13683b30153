// What the far field shows in an albedo picture, on either device.
#include "trainer/sky_albedo.h"

#include <gtest/gtest.h>

#include <array>
#include <vector>

#include "../../model/device_test.h"
#include "device/buffer.h"
#include "sample_batch.h"

namespace splatbus::trainer {
namespace {

using Pixel = std::array<std::uint8_t, 4>;

class SkyAlbedoOn : public testing::TestWithParam<Device> {
 protected:
  void SetUp() override {
    if (!has_device(GetParam())) GTEST_SKIP() << "no such device";
  }

  /// The albedo picture afterwards.
  std::vector<Pixel> add(const std::vector<Pixel>& color, const std::vector<Pixel>& albedo,
                         const math::Vec3& background) {
    const device::Stream stream(GetParam());
    device::Buffer<Pixel> lit(stream), own(stream);
    lit.assign(std::span(color));
    own.assign(std::span(albedo));
    add_sky_albedo(stream, lit.data()->data(), static_cast<std::uint32_t>(color.size()), background,
                   own.data()->data());
    return own.to_host();
  }
};

// Linear 0.25 is 137 in sRGB, 0.5 is 188, 0.75 is 225 (IEC 61966-2-1).
constexpr math::Vec3 kBackground{0.25F, 0.5F, 0.75F};
constexpr Pixel kPlain{137, 188, 225, 0}, kCloud{200, 220, 240, 0}, kSurface{90, 80, 70, 255}, kBlack{0, 0, 0, 0},
    kWood{120, 60, 30, 255};

TEST_P(SkyAlbedoOn, IsTheColorWhereNoSurfaceIs) {
  const std::vector<Pixel> color{kCloud, kSurface, kPlain, kCloud};
  const std::vector<Pixel> albedo{kBlack, kWood, kBlack, kBlack};
  const auto got = add(color, albedo, kBackground);
  for (const std::size_t sky : {0U, 2U, 3U}) {
    for (int c = 0; c < 3; ++c) EXPECT_EQ(got[sky][c], color[sky][c]) << sky;
  }
  EXPECT_EQ(got[1], kWood);
}

TEST_P(SkyAlbedoOn, AnEdgeHasItsShareOfTheBackground) {
  // Half a surface of linear albedo 0.5, so 0.25 in the picture; half of the background behind it: 0.375, 0.5, 0.625.
  const Pixel edge{150, 150, 150, 128}, half{137, 137, 137, 128};
  const auto got = add({edge, kCloud}, {half, kBlack}, kBackground);
  EXPECT_NEAR(got[0][0], 165, 1);
  EXPECT_NEAR(got[0][1], 188, 1);
  EXPECT_NEAR(got[0][2], 207, 1);
}

TEST_P(SkyAlbedoOn, WhatHasAnAlbedoIsASurfaceWhateverItsAlpha) {
  const Pixel untold{200, 220, 240, 0}, wood{120, 60, 30, 0};
  const std::vector<Pixel> albedo{wood, kBlack};
  const auto got = add({untold, kCloud}, albedo, kBackground);
  EXPECT_EQ(got[0], wood);
  EXPECT_EQ(got[1][0], kCloud[0]);
  EXPECT_EQ(add({untold, kPlain}, albedo, kBackground), albedo) << "no sky is in it";
}

TEST_P(SkyAlbedoOn, ABackgroundBeyondWhitePicturesIsWhite) {
  const Pixel white{255, 255, 255, 0}, edge{255, 255, 255, 230};
  const auto got = add({edge, kCloud, white}, {{0, 0, 0, 230}, kBlack, kBlack}, {5, 5, 5});
  EXPECT_NEAR(got[0][0], 88, 1) << "a tenth of white";
}

TEST_P(SkyAlbedoOn, NothingIsDoneBeforeAPlainBackground) {
  const Pixel rounded{138, 187, 223, 0}, edge{150, 150, 150, 128};
  const std::vector<Pixel> albedo{kBlack, kWood, {137, 137, 137, 128}, kBlack};
  EXPECT_EQ(add({kPlain, kSurface, edge, rounded}, albedo, kBackground), albedo);
}

INSTANTIATE_TEST_SUITE_P(Devices, SkyAlbedoOn, testing::Values(Device::Cpu, Device::Cuda), model::device_name);

}  // namespace
}  // namespace splatbus::trainer
