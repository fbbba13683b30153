#include "relight/visibility_backend.h"

#include <cassert>
#include <span>
#ifdef SPLATBUS_HAVE_CUDA
#include "relight/cuda/cuda_visibility.h"
#endif

namespace splatbus::relight {

namespace {

class CpuVisibility final : public VisibilityBackend {
 public:
  void compute(const GaussiansView& gaussians, const ObjectTransforms& objects, const LightDepthMap& map,
               const VisibilityOptions& options, float* visibility) override {
    compute_visibility(gaussians, objects, map, options, std::span(visibility, gaussians.count));
  }
};

}  // namespace

std::unique_ptr<VisibilityBackend> make_visibility_backend([[maybe_unused]] Device backend) {
#ifdef SPLATBUS_HAVE_CUDA
  if (backend == Device::Cuda) return make_cuda_visibility();
#endif
  assert(backend == Device::Cpu);
  return std::make_unique<CpuVisibility>();
}

}  // namespace splatbus::relight
