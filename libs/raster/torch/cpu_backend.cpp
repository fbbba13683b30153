#include <algorithm>
#include <cstring>
#include <memory>
#include <mutex>
#include <utility>

#include "raster/adam_kernel.h"
#include "raster/cpu/workers.h"
#include "raster/torch/backend.h"

namespace splatbus::raster {
namespace {

using torch::Tensor;

/// Rasterizers that nobody uses: their scratch memory is worth keeping from call to call.
class IdleRasterizers {
 public:
  std::unique_ptr<Rasterizer> take() {
    const std::lock_guard lock(mutex_);
    if (idle_.empty()) return make_cpu_rasterizer();
    std::unique_ptr<Rasterizer> rasterizer = std::move(idle_.back());
    idle_.pop_back();
    return rasterizer;
  }
  void give_back(std::unique_ptr<Rasterizer> rasterizer) {
    const std::lock_guard lock(mutex_);
    if (idle_.size() < kMaxCameras) idle_.push_back(std::move(rasterizer));
  }
  static IdleRasterizers& instance() {
    static auto* const rasterizers = new IdleRasterizers;  // outlives what threads and graphs hold at exit
    return *rasterizers;
  }

 private:
  std::mutex mutex_;
  std::vector<std::unique_ptr<Rasterizer>> idle_;
};

template <class T>
const T* data_or_null(const Tensor& plane) {
  return plane.defined() ? static_cast<const T*>(plane.data_ptr()) : nullptr;
}

GaussiansView view_of(const RasterCall& call, const Tensor& parameters) {
  GaussiansView view;
  view.layout = call.layout;
  view.count = view.stride = static_cast<std::size_t>(parameters.size(1));
  view.parameters = data_or_null<float>(parameters);
  view.normal = data_or_null<float>(call.planes.normal);
  view.visibility = data_or_null<float>(call.planes.visibility);
  view.object_id = data_or_null<std::uint32_t>(call.planes.object_id);
  view.flags = data_or_null<std::uint32_t>(call.planes.flags);
  return view;
}

void copy_to(const Image& image, const Tensor& pictures, std::size_t index) {
  if (!pictures.defined()) return;
  std::memcpy(pictures.data_ptr<float>() + index * image.data.size(), image.data.data(),
              image.data.size() * sizeof(float));
}

/// Picture `index` of a contiguous tensor, empty when there is none.
Image image_of(const Tensor& pictures, std::size_t index, std::uint32_t width, std::uint32_t height,
               std::uint32_t channels) {
  if (!pictures.defined()) return {};
  Image image(width, height, channels);
  std::memcpy(image.data.data(), pictures.data_ptr<float>() + index * image.data.size(),
              image.data.size() * sizeof(float));
  return image;
}

/// A Rasterizer a camera is kept for the backward pass.
class CpuPass final : public RasterPass {
 public:
  using RasterPass::RasterPass;
  CpuPass(const CpuPass&) = delete;
  CpuPass& operator=(const CpuPass&) = delete;
  ~CpuPass() override {
    for (auto& rasterizer : rasterizers_) IdleRasterizers::instance().give_back(std::move(rasterizer));
  }

  RasterizedViews forward(const Tensor& parameters, bool differentiable, std::vector<Tensor>& /*kept*/) override {
    const GaussiansView gaussians = view_of(call, parameters);
    const auto cameras = static_cast<std::int64_t>(call.cameras.size());
    const std::int64_t height = call.cameras[0].height, width = call.cameras[0].width;
    const auto type = parameters.options().requires_grad(false);
    RasterizedViews views{torch::empty({cameras, 3, height, width}, type), torch::empty({cameras, height, width}, type),
                          has_albedo(call) ? torch::empty({cameras, 3, height, width}, type) : Tensor(),
                          call.options.depth ? torch::empty({cameras, height, width}, type) : Tensor()};
    Render render;
    for (std::size_t k = 0; k < call.cameras.size(); ++k) {
      if (differentiable || rasterizers_.empty()) rasterizers_.push_back(IdleRasterizers::instance().take());
      Rasterizer& rasterizer = *rasterizers_.back();
      if (differentiable) {
        rasterizer.forward(gaussians, call.cameras[k], call.scene(k), call.options, render);
      } else {
        rasterizer.render(gaussians, call.cameras[k], call.scene(k), call.options, render);
      }
      copy_to(render.color, views.color, k);
      copy_to(render.alpha, views.alpha, k);
      copy_to(render.albedo, views.albedo, k);
      copy_to(render.depth, views.depth, k);
    }
    return views;
  }

  Tensor backward(const Tensor& parameters, const std::vector<Tensor>& /*kept*/,
                  const RasterizedViews& views) override {
    auto sums = std::make_shared<ParameterGradient>();
    sums->clear(view_of(call, parameters));
    for (std::size_t k = 0; k < call.cameras.size(); ++k) {
      const std::uint32_t width = call.cameras[k].width, height = call.cameras[k].height;
      const RenderGradient gradient{
          image_of(views.color, k, width, height, 3), image_of(views.alpha, k, width, height, 1),
          image_of(views.albedo, k, width, height, 3), image_of(views.depth, k, width, height, 1)};
      rasterizers_[k]->backward(gradient, *sums);
    }
    add_statistics(*sums);
    // In place: the tensor owns the sums.
    float* const values = sums->values.data();
    return torch::from_blob(
        values, parameters.sizes(), [sums = std::move(sums)](void*) mutable { sums.reset(); },
        parameters.options().requires_grad(false));
  }

 private:
  void add_statistics(const ParameterGradient& sums) const {
    const GaussianStatistics& to = call.statistics;
    for (std::size_t i = 0; i < sums.count; ++i) {
      if (to.mean2d_norm.defined()) to.mean2d_norm.data_ptr<float>()[i] += sums.mean2d_norm[i];
      if (to.contribution.defined()) {
        float& largest = to.contribution.data_ptr<float>()[i];
        largest = std::max(largest, sums.contribution[i]);
      }
      if (to.touched.defined()) to.touched.data_ptr<std::uint8_t>()[i] |= sums.touched[i];
    }
  }

  std::vector<std::unique_ptr<Rasterizer>> rasterizers_;
};

}  // namespace

c10::intrusive_ptr<RasterPass> make_cpu_pass(RasterCall call) {
  return c10::make_intrusive<CpuPass>(std::move(call));
}

LossAndGradient cpu_image_loss(const Tensor& rendered, const Tensor& targets, const LossOptions& options) {
  const std::int64_t pictures = rendered.size(0);
  const auto width = static_cast<std::uint32_t>(rendered.size(3)),
             height = static_cast<std::uint32_t>(rendered.size(2));
  const auto type = rendered.options().requires_grad(false);
  LossAndGradient out{torch::empty({pictures}, type), torch::empty(rendered.sizes(), type)};
  Image gradient;
  for (std::int64_t k = 0; k < pictures; ++k) {
    const auto index = static_cast<std::size_t>(k);
    const std::uint8_t* target = targets.data_ptr<std::uint8_t>() + index * std::size_t{width} * height * 4;
    out.loss.data_ptr<float>()[k] = image_loss(image_of(rendered, index, width, height, 3), target, options, gradient);
    copy_to(gradient, out.gradient, index);
  }
  return out;
}

void cpu_adam_step(const AdamTensors& adam) {
  const auto count = static_cast<std::size_t>(adam.parameters.size(1));
  AdamStep step;
  step.channels = static_cast<int>(adam.parameters.size(0));
  step.stride = step.gradient_stride = step.moment_stride = count;
  step.parameters = adam.parameters.data_ptr<float>();
  step.gradient = adam.gradient.data_ptr<float>();
  step.touched = adam.touched.data_ptr<std::uint8_t>();
  step.learning_rate = adam.rates.data_ptr<float>();
  step.first = adam.first.data_ptr<float>();
  step.second = adam.second.data_ptr<float>();
  step.steps = static_cast<std::uint32_t*>(adam.steps.data_ptr());
  step.beta1 = adam.beta1;
  step.beta2 = adam.beta2;
  step.epsilon = adam.epsilon;
  step.lr_half_life_steps = adam.lr_half_life_steps;
  step.lr_min_factor = adam.lr_min_factor;
  cpu::Workers(0).for_pieces(count, kAdamPiece, [&](std::size_t begin, std::size_t end) {
    AdamStep piece = step;
    piece.parameters += begin;
    piece.gradient += begin;
    piece.touched += begin;
    piece.first += begin;
    piece.second += begin;
    piece.steps += begin;
    adam_range(piece, end - begin);
  });
}

}  // namespace splatbus::raster
