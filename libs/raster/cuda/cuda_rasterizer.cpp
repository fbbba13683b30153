#include "raster/cuda/cuda_rasterizer.h"

#include <stdexcept>

#include "raster/adam.h"
#include "raster/cuda/forward_pass.h"
#include "raster/rasterizer.h"

namespace splatbus::raster {
namespace {

using cuda::check;

/// The Rasterizer interface over host memory: every call copies its model in and its planes out. For viewers,
/// evaluation and checks against the reference; training on the device uses cuda::TrainStep.
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
    if (gradient.alpha.channels != 0) throw std::invalid_argument("the CUDA rasteriser has no gradient through alpha");
    const cuda::DeviceGaussians& gaussians = model_.view();
    const auto channels = static_cast<std::size_t>(gaussians.layout.channels());
    const auto count = static_cast<std::size_t>(gaussians.count);
    if (out.count != count || out.layout != gaussians.layout || out.values.size() < channels * out.stride) {
      throw std::invalid_argument("rasterizer: the gradient was not cleared for these Gaussians");
    }
    const cuda::WorkspaceView& w = pass_.workspace();
    const std::size_t pixels = static_cast<std::size_t>(w.width) * static_cast<std::size_t>(w.height);
    if (count == 0 || pixels == 0) return;
    upload_gradient(gradient.color, w.color_gradient, pixels);
    if (w.albedo != nullptr) upload_gradient(gradient.albedo, w.albedo_gradient, pixels);
    cuda::launch_blend_backward(gaussians, w, pass_.stream());
    gradient_.resize(channels * count);
    gradient_.clear(pass_.stream());
    touched_.resize(count);
    touched_.clear(pass_.stream());
    cuda::launch_gradient(gaussians, w, pass_.project_options(), gradient_.data(), touched_.data(), out.active_channels,
                          pass_.stream());
    std::vector<float> host(channels * count);
    std::vector<std::uint8_t> touched(count);
    gradient_.download(host.data(), host.size(), pass_.stream());
    touched_.download(touched.data(), count, pass_.stream());
    check(cudaStreamSynchronize(pass_.stream()), "backward");
    const std::size_t active = out.active_channels > 0 ? static_cast<std::size_t>(out.active_channels) : channels;
    for (std::size_t c = 0; c < active; ++c) {
      for (std::size_t i = 0; i < count; ++i) out.values[c * out.stride + i] += host[c * count + i];
    }
    for (std::size_t i = 0; i < count; ++i) out.touched[i] |= touched[i];
  }

  void backward_step(const RenderGradient& gradient, const std::vector<float>& learning_rate, Adam& adam,
                     float* parameters, ParameterGradient& statistics) override {
    ParameterGradient full;
    full.active_channels = statistics.active_channels;
    full.clear(gaussians_);
    backward(gradient, full);
    adam.step(parameters, gaussians_.flags, full, learning_rate, 0);
    for (std::size_t i = 0; i < full.count; ++i) statistics.touched[i] |= full.touched[i];
  }

 private:
  void draw(const GaussiansView& gaussians, const Camera& camera, const SceneState& scene, const RenderOptions& options,
            bool training, Render& out) {
    if (gaussians.count > gaussians.stride) throw std::invalid_argument("rasterizer: stride is below count");
    gaussians_ = gaussians;
    model_.upload(gaussians, pass_.stream());
    pass_.draw(model_.view(), camera, scene, options, training);
    pass_.download(out);
  }

  void upload_gradient(const Image& from, float* to, std::size_t pixels) {
    if (from.data.empty()) {
      check(cudaMemsetAsync(to, 0, 3 * pixels * sizeof(float), pass_.stream()), "clearing a gradient");
    } else {
      check(cudaMemcpyAsync(to, from.data.data(), 3 * pixels * sizeof(float), cudaMemcpyHostToDevice, pass_.stream()),
            "copying a gradient");
    }
  }

  cuda::ForwardPass pass_;
  cuda::DeviceModel model_;
  device::Buffer<float> gradient_;
  device::Buffer<std::uint8_t> touched_;
  GaussiansView gaussians_;
};

}  // namespace

std::unique_ptr<Rasterizer> make_cuda_rasterizer() {
  return std::make_unique<CudaRasterizer>();
}

}  // namespace splatbus::raster
