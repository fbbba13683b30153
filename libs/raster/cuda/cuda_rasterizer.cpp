#include "raster/cuda/cuda_rasterizer.h"

#include <algorithm>
#include <stdexcept>

#include "raster/adam.h"
#include "raster/cuda/device_model.h"
#include "raster/cuda/kernels.h"
#include "raster/cuda/view_tables.h"
#include "raster/rasterizer.h"

namespace splatbus::raster {
namespace {

using cuda::check;

void check_arguments(const GaussiansView& gaussians, const Camera& camera, const RenderOptions& options) {
  if (options.depth) throw std::invalid_argument("the CUDA rasteriser renders no depth plane");
  if (gaussians.count > gaussians.stride) throw std::invalid_argument("rasterizer: stride is below count");
  if (gaussians.count > 0 && gaussians.parameters == nullptr) throw std::invalid_argument("rasterizer: no parameters");
  if (camera.role == CameraRole::Light) throw std::invalid_argument("rasterizer: light cameras are orthographic");
  constexpr std::uint32_t kMaxSide = 1U << 15U;
  if (camera.width > kMaxSide || camera.height > kMaxSide) throw std::invalid_argument("rasterizer: picture too large");
}

/// The Rasterizer interface over host memory: every call copies its model in and its planes out. For viewers,
/// evaluation and checks against the reference; training on the device uses cuda::TrainStep.
class CudaRasterizer final : public Rasterizer {
 public:
  CudaRasterizer() { check(cudaStreamCreate(&stream_), "creating a stream"); }
  ~CudaRasterizer() override { cudaStreamDestroy(stream_); }
  CudaRasterizer(const CudaRasterizer&) = delete;
  CudaRasterizer& operator=(const CudaRasterizer&) = delete;

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
    const cuda::WorkspaceView& w = workspace_.view();
    const std::size_t pixels = static_cast<std::size_t>(w.width) * static_cast<std::size_t>(w.height);
    if (count == 0 || pixels == 0) return;
    upload_gradient(gradient.color, w.color_gradient, pixels);
    if (w.albedo != nullptr) upload_gradient(gradient.albedo, w.albedo_gradient, pixels);
    cuda::launch_blend_backward(gaussians, w, stream_);
    gradient_.resize(channels * count);
    gradient_.clear(stream_);
    touched_.resize(count);
    touched_.clear(stream_);
    cuda::launch_gradient(gaussians, w, project_, gradient_.data(), touched_.data(), out.active_channels, stream_);
    std::vector<float> host(channels * count);
    std::vector<std::uint8_t> touched(count);
    gradient_.download(host.data(), host.size(), stream_);
    touched_.download(touched.data(), count, stream_);
    check(cudaStreamSynchronize(stream_), "backward");
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
    check_arguments(gaussians, camera, options);
    const bool albedo = options.albedo && gaussians.layout.appearance == Appearance::Transfer;
    out.color = Image(camera.width, camera.height, 3);
    out.alpha = Image(camera.width, camera.height, 1);
    out.albedo = albedo ? Image(camera.width, camera.height, 3) : Image();
    out.depth = Image();
    gaussians_ = gaussians;
    model_.upload(gaussians, stream_);
    const cuda::SceneView view{camera, &scene};
    const cuda::ViewTables tables = cuda::make_view_tables({&view, 1}, gaussians.layout.appearance);
    const auto slots = cuda::object_slots(gaussians.object_id, gaussians.count, tables.object_ids);
    cuda::WorkspaceRequest request{.count = static_cast<int>(gaussians.count),
                                   .batch = 1,
                                   .width = static_cast<int>(camera.width),
                                   .height = static_cast<int>(camera.height),
                                   .object_count = tables.object_count,
                                   .albedo = albedo,
                                   .training = training,
                                   .pair_capacity = std::max(pair_capacity_, 1U << 16U)};
    project_ = {.blur_px2 = options.blur_px2, .antialias = options.antialias};
    for (;;) {
      workspace_.reserve(request);
      const cuda::WorkspaceView& w = workspace_.view();
      check(cudaMemcpyAsync(w.views, tables.views.data(), sizeof(cuda::DeviceView), cudaMemcpyHostToDevice, stream_),
            "copying views");
      check(cudaMemcpyAsync(w.object_views, tables.object_views.data(),
                            sizeof(cuda::ObjectView) * tables.object_views.size(), cudaMemcpyHostToDevice, stream_),
            "copying object views");
      if (!slots.empty()) {
        check(cudaMemcpyAsync(w.object_slot, slots.data(), sizeof(std::uint16_t) * slots.size(), cudaMemcpyHostToDevice,
                              stream_),
              "copying object slots");
      }
      cuda::launch_project(model_.view(), w, project_, stream_);
      std::uint32_t pairs = 0;
      check(cudaMemcpyAsync(&pairs, w.pair_count, sizeof(pairs), cudaMemcpyDeviceToHost, stream_),
            "reading the pair count");
      check(cudaStreamSynchronize(stream_), "projection");
      if (pairs <= w.pair_capacity) break;
      pair_capacity_ = request.pair_capacity = pairs + pairs / 4;
    }
    const cuda::WorkspaceView& w = workspace_.view();
    cuda::launch_sort(w, stream_);
    cuda::launch_blend_forward(model_.view(), w, stream_);
    const std::size_t pixels = static_cast<std::size_t>(w.width) * w.height;
    download(w.color, out.color, 3 * pixels);
    download(w.transmittance, out.alpha, pixels);
    if (albedo) download(w.albedo, out.albedo, 3 * pixels);
    check(cudaStreamSynchronize(stream_), "forward");
    for (float& value : out.alpha.data) value = 1.0F - value;
  }

  void download(const float* from, Image& to, std::size_t elements) {
    check(cudaMemcpyAsync(to.data.data(), from, elements * sizeof(float), cudaMemcpyDeviceToHost, stream_),
          "copying a picture");
  }

  void upload_gradient(const Image& from, float* to, std::size_t pixels) {
    if (from.data.empty()) {
      check(cudaMemsetAsync(to, 0, 3 * pixels * sizeof(float), stream_), "clearing a gradient");
    } else {
      check(cudaMemcpyAsync(to, from.data.data(), 3 * pixels * sizeof(float), cudaMemcpyHostToDevice, stream_),
            "copying a gradient");
    }
  }

  cudaStream_t stream_ = nullptr;
  cuda::DeviceModel model_;
  cuda::Workspace workspace_;
  cuda::ProjectOptions project_;
  device::Buffer<float> gradient_;
  device::Buffer<std::uint8_t> touched_;
  GaussiansView gaussians_;
  std::uint32_t pair_capacity_ = 0;
};

}  // namespace

std::unique_ptr<Rasterizer> make_cuda_rasterizer() {
  return std::make_unique<CudaRasterizer>();
}

}  // namespace splatbus::raster
