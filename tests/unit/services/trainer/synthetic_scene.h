#pragma once

#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>
#include <vector>

#include "gaussians/model.h"
#include "raster/rasterizer.h"
#include "sample_batch.h"
#include "trainer/view_store.h"

namespace splatbus::trainer {

/// A floor of Gaussians, photographed by the rasterizer itself from cameras in a circle: what training must find again.
class SyntheticScene {
 public:
  /// Pictures of `size` x `size`.
  explicit SyntheticScene(std::size_t gaussians = 300, int cameras = 6, std::uint32_t size = 48)
      : truth_(sample_batch(1, 1, gaussians)), size_(size) {
    for (std::size_t i = 0; i < 3 * gaussians; ++i) truth_.log_scale[i] = std::log(i / gaussians == 1 ? 0.03F : 0.18F);
    scene_.light = truth_.scene.light;
    scene_.light.background = glm::vec3(0.2F);
    const GaussiansBuffer truth = gaussians_of(truth_);
    const auto rasterizer = raster::make_cpu_rasterizer(1);
    for (int c = 0; c < cameras; ++c) {
      const float angle = 2.0F * std::numbers::pi_v<float> * static_cast<float>(c) / static_cast<float>(cameras);
      TrainingView view;
      view.camera = look_at({3.5F * std::cos(angle), 2.5F, 3.5F * std::sin(angle)}, {0, 0, 0}, size, size, 1.0F);
      view.camera.id = static_cast<std::uint32_t>(c);
      view.scene = scene_;
      raster::Render render;
      rasterizer->render(truth.view(), view.camera, scene_, {.albedo = true, .depth = true}, render);
      view.color = Pixels<std::uint8_t>(to_rgba(render.color));
      view.albedo = Pixels<std::uint8_t>(to_rgba(render.albedo));
      std::vector<float> depth(std::size_t{size} * size);
      for (std::size_t i = 0; i < depth.size(); ++i) {
        depth[i] = render.alpha.data[i] > 0.5F ? render.depth.data[i] / render.alpha.data[i] : 0.0F;
      }
      view.depth = Pixels<float>(std::move(depth));
      views_.push_back(std::make_shared<const TrainingView>(std::move(view)));
    }
  }

  [[nodiscard]] const std::vector<TrainingViewPtr>& views() const { return views_; }
  [[nodiscard]] const SceneState& scene() const { return scene_; }
  [[nodiscard]] const SampleBatch& truth() const { return truth_; }

  /// The truth with means, scales and albedo astray.
  [[nodiscard]] SampleBatch perturbed() const {
    SampleBatch batch = truth_;
    std::mt19937 random(99);
    std::uniform_real_distribution<float> astray(-1.0F, 1.0F);
    for (float& value : batch.mean) value += 0.03F * astray(random);
    for (float& value : batch.log_scale) value += 0.2F * astray(random);
    for (float& value : batch.albedo) value = std::clamp(value + 0.25F * astray(random), 0.0F, 1.0F);
    return batch;
  }

  static std::vector<std::uint8_t> to_rgba(const raster::Image& image) {
    std::vector<std::uint8_t> rgba(std::size_t{image.width} * image.height * 4, 255);
    for (std::uint32_t c = 0; c < 3; ++c) {
      for (std::size_t i = 0; i < std::size_t{image.width} * image.height; ++i) {
        const float shown = srgb_from_linear(std::clamp(image.plane(c)[i], 0.0F, 1.0F));
        rgba[4 * i + c] = static_cast<std::uint8_t>(std::lround(255.0F * shown));
      }
    }
    return rgba;
  }

  /// Mean over all views, dB.
  [[nodiscard]] double psnr(const GaussiansView& gaussians) const {
    const auto rasterizer = raster::make_cpu_rasterizer(1);
    double square = 0;
    for (const auto& view : views_) {
      raster::Render render;
      rasterizer->render(gaussians, view->camera, view->scene, {}, render);
      const auto shown = to_rgba(render.color);
      for (std::size_t i = 0; i < shown.size(); ++i) square += std::pow(double(shown[i]) - double(view->color[i]), 2);
    }
    const double samples = 3.0 * size_ * size_ * static_cast<double>(views_.size());
    return 10.0 * std::log10(255.0 * 255.0 * samples / square);
  }

 private:
  static GaussiansBuffer gaussians_of(const SampleBatch& batch) {
    GaussiansBuffer gaussians({}, batch.count);
    const auto copy = [&](const std::vector<float>& from, std::vector<float>& to, int channel) {
      std::copy(from.begin(), from.end(),
                to.begin() + static_cast<std::ptrdiff_t>(channel) * static_cast<std::ptrdiff_t>(batch.count));
    };
    copy(batch.mean, gaussians.parameters, ParameterLayout::kMean);
    copy(batch.log_scale, gaussians.parameters, ParameterLayout::kLogScale);
    copy(batch.rotation, gaussians.parameters, ParameterLayout::kRotation);
    copy(batch.opacity_logit, gaussians.parameters, ParameterLayout::kOpacityLogit);
    copy(batch.albedo, gaussians.parameters, ParameterLayout::kAlbedo);
    copy(batch.normal, gaussians.normal, 0);
    copy(batch.visibility, gaussians.visibility, 0);
    return gaussians;
  }

  SampleBatch truth_;
  std::uint32_t size_;
  SceneState scene_;
  std::vector<TrainingViewPtr> views_;
};

}  // namespace splatbus::trainer
