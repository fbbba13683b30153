#include "raster/model_renderer.h"

#include <cassert>
#ifdef SPLATBUS_HAVE_CUDA
#include "raster/cuda/cuda_model_renderer.h"
#endif

namespace splatbus::raster {

namespace {

class CpuModelRenderer final : public ModelRenderer {
 public:
  explicit CpuModelRenderer(int threads) : rasterizer_(make_cpu_rasterizer(threads)) {}

  void take(const GaussiansView& gaussians) override { gaussians_ = gaussians; }
  void read_in_place(const GaussiansView& gaussians) override { gaussians_ = gaussians; }
  void draw(const Camera& camera, const SceneState& scene, const RenderOptions& options, Render& out) override {
    rasterizer_->render(gaussians_, camera, scene, options, out);
  }

 private:
  std::unique_ptr<Rasterizer> rasterizer_;
  GaussiansView gaussians_;
};

}  // namespace

std::unique_ptr<ModelRenderer> make_model_renderer(Device device, int threads) {
#ifdef SPLATBUS_HAVE_CUDA
  if (device == Device::Cuda) return cuda::make_cuda_model_renderer();
#endif
  assert(device == Device::Cpu);
  static_cast<void>(device);
  return std::make_unique<CpuModelRenderer>(threads);
}

}  // namespace splatbus::raster
