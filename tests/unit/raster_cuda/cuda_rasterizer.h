#pragma once

#include <algorithm>
#include <memory>
#include <stdexcept>
#include <vector>

#include "raster/adam.h"
#include "raster/cuda/forward_pass.h"
#include "raster/rasterizer.h"

namespace splatbus::raster::testing {

/// The Rasterizer interface on the device over host memory, to be compared with the CPU backend: every call copies its
/// model in and its planes out.
class CudaRasterizer final : public Rasterizer {
 public:
  void forward(const GaussiansView& gaussians, const Camera& camera, const SceneState& scene,
               const RenderOptions& options, Render& out) override {
    draw(gaussians, camera, scene, options, true, out);
  }

  void render(const GaussiansView& gaussians, const Camera& camera, const SceneState& scene,
              const RenderOptions& options, Render& out) override {
    draw(gaussians, camera, scene, options, false, out);
  }

  void backward(const RenderGradient& gradient, ParameterGradient& out) override {
    const cuda::DeviceGaussians& gaussians = model_.view();
    const auto channels = static_cast<std::size_t>(gaussians.layout.channels());
    const auto count = static_cast<std::size_t>(gaussians.count);
    if (out.count != count || out.layout != gaussians.layout || out.values.size() < channels * out.stride) {
      throw std::invalid_argument("rasterizer: the gradient was not cleared for these Gaussians");
    }
    const cuda::WorkspaceView w = upload(gradient);
    if (count == 0 || w.width == 0 || w.height == 0) return;
    cuda::launch_blend_backward(gaussians, w, pass_.stream());
    for (device::Buffer<float>* sums : {&gradient_, &mean2d_norm_, &contribution_}) {
      sums->resize(sums == &gradient_ ? channels * count : count);
      sums->clear(pass_.stream());
    }
    touched_.resize(count);
    touched_.clear(pass_.stream());
    mean2d_steps_.resize(count);
    mean2d_steps_.clear(pass_.stream());
    cuda::launch_gradient(gaussians, w, pass_.project_options(), gradient_.data(), touched_.data(),
                          {.mean2d_norm = mean2d_norm_.data(), .steps = mean2d_steps_.data()}, out.active_channels,
                          pass_.stream());
    cuda::launch_contribution(gaussians, w, 0, contribution_.data(), pass_.stream());
    add_to(out, channels, count);
  }

  void backward_step(const RenderGradient& gradient, const std::vector<float>& learning_rate, Adam& adam,
                     float* parameters, ParameterGradient& statistics) override {
    ParameterGradient full;
    full.active_channels = statistics.active_channels;
    full.clear(gaussians_);
    backward(gradient, full);
    adam.step(gaussians_, parameters, full, learning_rate, 0);
    for (std::size_t i = 0; i < full.count; ++i) {
      statistics.touched[i] |= full.touched[i];
      statistics.mean2d_norm[i] += full.mean2d_norm[i];
      statistics.contribution[i] = std::max(statistics.contribution[i], full.contribution[i]);
    }
  }

 private:
  void draw(const GaussiansView& gaussians, const Camera& camera, const SceneState& scene, const RenderOptions& options,
            bool training, Render& out) {
    if (!gaussians.has_pages() && gaussians.count > gaussians.stride)
      throw std::invalid_argument("rasterizer: stride is below count");
    gaussians_ = gaussians;
    model_.upload(gaussians, pass_.stream());
    pass_.draw(model_.view(), camera, scene, options, training);
    pass_.download(out);
  }

  /// The workspace of the last forward pass, with these gradients in it.
  cuda::WorkspaceView upload(const RenderGradient& gradient) {
    cuda::WorkspaceView w = pass_.workspace();
    const std::size_t pixels = static_cast<std::size_t>(w.width) * static_cast<std::size_t>(w.height);
    const auto fits = [&](const Image& image, std::size_t channels) {
      return image.data.empty() || image.data.size() == channels * pixels;
    };
    if (!fits(gradient.color, 3) || !fits(gradient.alpha, 1) || !fits(gradient.albedo, 3) || !fits(gradient.depth, 1)) {
      throw std::invalid_argument("rasterizer: a gradient's size is not that of the render");
    }
    if (pixels == 0) return w;
    upload_plane(gradient.color, w.color_gradient, 3 * pixels);
    if (w.albedo != nullptr) upload_plane(gradient.albedo, w.albedo_gradient, 3 * pixels);
    if (w.depth != nullptr) upload_plane(gradient.depth, w.depth_gradient, pixels);
    if (w.alpha_gradient == nullptr && !gradient.alpha.data.empty()) {
      alpha_gradient_.resize(pixels);
      w.alpha_gradient = alpha_gradient_.data();
    }
    if (w.alpha_gradient != nullptr) upload_plane(gradient.alpha, w.alpha_gradient, pixels);
    return w;
  }

  void upload_plane(const Image& from, float* to, std::size_t values) {
    if (from.data.empty()) {
      device::check(cudaMemsetAsync(to, 0, values * sizeof(float), pass_.stream()), "clearing a gradient");
    } else {
      device::check(
          cudaMemcpyAsync(to, from.data.data(), values * sizeof(float), cudaMemcpyHostToDevice, pass_.stream()),
          "copying a gradient");
    }
  }

  void add_to(ParameterGradient& out, std::size_t channels, std::size_t count) {
    std::vector<float> values(channels * count), mean2d_norm(count), contribution(count);
    std::vector<std::uint8_t> touched(count);
    gradient_.download(values.data(), values.size(), pass_.stream());
    touched_.download(touched.data(), count, pass_.stream());
    mean2d_norm_.download(mean2d_norm.data(), count, pass_.stream());
    contribution_.download(contribution.data(), count, pass_.stream());
    device::check(cudaStreamSynchronize(pass_.stream()), "backward");
    const std::size_t active = out.active_channels > 0 ? static_cast<std::size_t>(out.active_channels) : channels;
    for (std::size_t c = 0; c < active; ++c) {
      for (std::size_t i = 0; i < count; ++i) out.values[c * out.stride + i] += values[c * count + i];
    }
    for (std::size_t i = 0; i < count; ++i) {
      out.touched[i] |= touched[i];
      out.mean2d_norm[i] += mean2d_norm[i];
      out.contribution[i] = std::max(out.contribution[i], contribution[i]);
    }
  }

  cuda::ForwardPass pass_;
  cuda::DeviceModel model_;
  device::Buffer<float> gradient_, mean2d_norm_, contribution_, alpha_gradient_;
  device::Buffer<std::uint8_t> touched_;
  device::Buffer<std::uint32_t> mean2d_steps_;
  GaussiansView gaussians_;
};

inline std::unique_ptr<Rasterizer> make_cuda_rasterizer() {
  return std::make_unique<CudaRasterizer>();
}

}  // namespace splatbus::raster::testing
