// What a step's pictures show of each page, and what of them is masked.
#include "../gaussians/paged_model.h"
#include "../raster/scenes.h"
#include "cuda_scenes.h"
#include "raster/cuda/device_model.h"
#include "raster/cuda/train_step.h"

namespace splatbus::raster::testing {
namespace {

constexpr std::uint32_t kSide = 64;

/// Opaque discs that face the camera, each in a page of its own, and `sheets` that hide all from it.
TestScene discs(std::size_t sheets = 0) {
  TestScene scene(radiance_layout(0), 4 + sheets);
  const auto place = [&](std::size_t i, glm::vec3 mean, float scale) {
    for (int c = 0; c < 3; ++c) scene.at(c, i) = mean[c];
    for (int c = 3; c < 6; ++c) scene.at(c, i) = std::log(scale);
    scene.at(6, i) = 1;
    scene.at(10, i) = 9;
    scene.object_id[i] = static_cast<std::uint32_t>(std::min<std::size_t>(i, 4)) + 1;
    scene.state.objects[scene.object_id[i]] = ObjectTransform();
  };
  place(0, {-0.6F, 0, 0}, 0.02F);
  place(1, {0.6F, 0, 0}, 0.02F);
  place(2, {0.5F, 0, 1}, 0.06F);
  place(3, {-30, 0, 0}, 0.02F);  // outside of the picture
  for (std::size_t i = 4; i < scene.count; ++i) place(i, {0, 0, 2}, 3.0F);
  return scene;
}

/// A step on one picture of a model in pages, which changes nothing.
class Looking {
 public:
  explicit Looking(const TestScene& scene, const cuda::TrainStepOptions& options)
      : paged_(scene.view(), 50), state_(scene.state), train_(options) {
    model_.upload(paged_.bounded_view(), nullptr);
    cudaDeviceSynchronize();
    train_.set_model(model_.view());
    train_.set_learning_rates(std::vector<float>(static_cast<std::size_t>(scene.layout.channels()), 0.0F));
    target_.assign(std::size_t{4} * kSide * kSide, 0);
  }

  /// The picture without an error, in bytes.
  void aim_at_what_shows() {
    static_cast<void>(step());
    const std::vector<float> color = shown(train_.workspace().color, 3);
    for (std::size_t i = 0; i < color.size() / 3; ++i) {
      for (std::size_t c = 0; c < 3; ++c) {
        const float value = std::clamp(color[c * kSide * kSide + i], 0.0F, 1.0F);
        target_[4 * i + c] = static_cast<std::uint8_t>(std::lround(255 * value));
      }
    }
  }
  /// Brighter by so many levels where chosen(x, y), or darker where it would be too bright.
  template <class Chosen>
  void add_error(int levels, Chosen chosen) {
    for (std::uint32_t i = 0; i < kSide * kSide; ++i) {
      for (std::uint32_t c = 0; c < 3 && chosen(i % kSide, i / kSide); ++c) {
        std::uint8_t& value = target_[4 * i + c];
        value = static_cast<std::uint8_t>(value + levels <= 255 ? value + levels : value - levels);
      }
    }
  }

  cuda::TrainStep::Report step() {
    picture_.upload(target_.data(), target_.size(), nullptr);
    own_mask_.upload(mask.data(), mask.size(), nullptr);
    metres_.upload(depth.data(), depth.size(), nullptr);
    cudaDeviceSynchronize();
    const cuda::TrainView view{.view = {camera_, &state_},
                               .color = picture_.data(),
                               .depth = depth.empty() ? nullptr : metres_.data(),
                               .mask = mask.empty() ? nullptr : own_mask_.data()};
    train_.step({&view, 1});
    return train_.finished(true);
  }
  std::vector<PageLook> looks() { return step().looks.at(0).pages; }

  template <class T>
  std::vector<T> shown(const T* plane, std::size_t channels) {
    std::vector<T> host(channels * kSide * kSide);
    cudaStreamSynchronize(train_.stream());
    cudaMemcpy(host.data(), plane, host.size() * sizeof(T), cudaMemcpyDeviceToHost);
    return host;
  }
  [[nodiscard]] const cuda::WorkspaceView& workspace() const { return train_.workspace(); }
  [[nodiscard]] const test::PagedModel& paged() const { return paged_; }

  std::vector<std::uint8_t> mask;
  std::vector<float> depth;

 private:
  test::PagedModel paged_;
  SceneState state_;
  Camera camera_ = look_at({0, 0, 4}, {0, 0, 0}, kSide, kSide, 0.9F);
  cuda::DeviceModel model_;
  cuda::TrainStep train_;
  std::vector<std::uint8_t> target_;
  device::Buffer<std::uint8_t> picture_, own_mask_;
  device::Buffer<float> metres_;
};

TEST_F(CudaTest, PagesAreLookedAtInTheTilesThatTheyShowIn) {
  Looking looking(discs(), {.look_interval = 1});
  looking.aim_at_what_shows();
  auto seen = looking.looks();
  ASSERT_EQ(seen.size(), 3U) << "one is outside";
  for (std::size_t k = 0; k < 3; ++k) {
    EXPECT_EQ(seen[k].page, k);
    EXPECT_GT(seen[k].pairs, 0U);
    EXPECT_LE(seen[k].pairs, 4U) << "tiles of 16 pixels";
    EXPECT_LT(seen[k].error, 0.5 / 255);
  }
  looking.add_error(51, [](std::uint32_t x, std::uint32_t) { return x < kSide / 2; });
  seen = looking.looks();
  EXPECT_NEAR(seen[0].error, 0.2, 1.0 / 255);
  EXPECT_LT(seen[1].error, 0.5 / 255);
  EXPECT_LT(seen[2].error, 0.5 / 255);
  // What is masked takes no part in a tile's mean.
  looking.add_error(51, [](std::uint32_t x, std::uint32_t) { return x >= kSide / 2 && x % 2 == 0; });
  EXPECT_NEAR(looking.looks()[1].error, 0.1, 1.0 / 255);
  looking.mask.assign(kSide * kSide, 0);
  for (std::size_t i = 0; i < looking.mask.size(); ++i) looking.mask[i] = i % 2 == 0 ? 0 : 255;
  EXPECT_NEAR(looking.looks()[1].error, 0.2, 1.0 / 255);
  looking.mask.assign(kSide * kSide, 255);
  EXPECT_TRUE(looking.looks().empty());
}

TEST_F(CudaTest, PagesThatAreHiddenAreNotLookedAt) {
  Looking looking(discs(40), {.look_interval = 1});
  const auto seen = looking.looks();
  ASSERT_EQ(seen.size(), 1U);
  EXPECT_EQ(seen[0].page, looking.paged().ranges.back().first / kPageLanes);
}

TEST_F(CudaTest, StepsInBetweenSayOnlyTheirLoss) {
  Looking looking(discs(), {.look_interval = 3});
  for (int k = 0; k < 7; ++k) {
    const auto report = looking.step();
    ASSERT_EQ(report.looks.size(), 1U);
    EXPECT_EQ(report.looks[0].looked, k % 3 == 0) << k;
    EXPECT_EQ(report.looks[0].pages.empty(), k % 3 != 0) << k;
    EXPECT_NEAR(report.looks[0].loss, report.loss, 1e-6);
  }
}

TEST_F(CudaTest, WhatNothingModelsIsMaskedSquareBySquare) {
  constexpr float kOpacity = 0.5F;
  Looking looking(discs(), {.mask_opacity = kOpacity});
  looking.depth.assign(kSide * kSide, 3.0F);
  for (std::size_t i = 0; i < std::size_t{kSide} * 20; ++i) looking.depth[i] = i % 2 == 0 ? 0.0F : INFINITY;
  looking.mask.assign(kSide * kSide, 0);
  for (std::size_t i = 0; i < looking.mask.size(); i += 7) looking.mask[i] = 9;
  const auto report = looking.step();
  const auto transmittance = looking.shown(looking.workspace().transmittance, 1);
  const auto masked = looking.shown(looking.workspace().mask, 1);
  std::size_t by_model = 0, modelled = 0;
  for (std::uint32_t i = 0; i < kSide * kSide; ++i) {
    const std::uint32_t x0 = i % kSide / 8 * 8, y0 = i / kSide / 8 * 8;
    double sum = 0, surface = 0;
    for (std::uint32_t y = y0; y < y0 + 8; ++y) {
      for (std::uint32_t x = x0; x < x0 + 8; ++x) {
        const std::uint32_t k = y * kSide + x;
        if (!(looking.depth[k] > 0) || std::isinf(looking.depth[k])) continue;
        sum += 1 - transmittance[k];
        surface += 1;
      }
    }
    const bool is_surface = looking.depth[i] > 0 && std::isfinite(looking.depth[i]);
    const bool lacks = is_surface && 1 - transmittance[i] < kOpacity && sum < kOpacity * surface;
    ASSERT_EQ(masked[i] != 0, lacks || looking.mask[i] != 0) << i;
    by_model += lacks && looking.mask[i] == 0 ? 1 : 0;
    modelled += transmittance[i] < kOpacity ? 1 : 0;
  }
  EXPECT_GT(by_model, 1000U);
  EXPECT_GT(modelled, 4U);
  EXPECT_NEAR(report.masked_share, static_cast<double>(by_model) / (kSide * kSide), 1e-9);
}

}  // namespace
}  // namespace splatbus::raster::testing
