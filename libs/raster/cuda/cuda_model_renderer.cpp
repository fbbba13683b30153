#include "raster/cuda/cuda_model_renderer.h"

#include <stdexcept>

#include "raster/cuda/forward_pass.h"

namespace splatbus::raster::cuda {
namespace {

class CudaModelRenderer final : public ModelRenderer {
 public:
  void take(const GaussiansView& gaussians) override {
    if (!gaussians.has_pages() && gaussians.count > gaussians.stride)
      throw std::invalid_argument("rasterizer: stride is below count");
    copy_.upload(gaussians, pass_.stream());
    // The caller's planes may change as soon as this returns.
    check(cudaStreamSynchronize(pass_.stream()), "copying a model to the device");
    gaussians_ = copy_.view();
  }

  void read_in_place(const GaussiansView& gaussians) override {
    gaussians_ = device_gaussians(gaussians);
    ranges_.upload(gaussians, pass_.stream());
    ranges_.bind(gaussians_);
  }

  void draw(const Camera& camera, const SceneState& scene, const RenderOptions& options, Render& out) override {
    pass_.draw(gaussians_, camera, scene, options, false);
    pass_.download(out);
  }

 private:
  ForwardPass pass_;
  DeviceModel copy_;
  DeviceRanges ranges_;  // of a model that is read in place
  DeviceGaussians gaussians_;
};

}  // namespace

std::unique_ptr<ModelRenderer> make_cuda_model_renderer() {
  return std::make_unique<CudaModelRenderer>();
}

}  // namespace splatbus::raster::cuda
