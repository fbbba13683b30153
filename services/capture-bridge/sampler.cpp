#include "capture-bridge/sampler.h"

#include <stdexcept>

#include "capture-bridge/sampling.h"
#ifdef SPLATBUS_HAVE_CUDA
#include "capture-bridge/cuda/cuda_sampler.h"
#endif

namespace splatbus::capture_bridge {

namespace {

class CpuSampler final : public Sampler {
 public:
  RoundSamples sample(Views views, const ObjectTransforms& round_objects, const SamplingOptions& options) override {
    round_ = sample_views(views, round_objects, options);
    const SampleSet& samples = round_.samples;
    const auto floats = [](const std::vector<glm::vec3>& vectors) {
      return reinterpret_cast<const float*>(vectors.data());
    };
    RoundSamples out;
    static_cast<RoundCounts&>(out) = round_;
    out.size = samples.size();
    out.position = floats(samples.position);
    out.normal = floats(samples.normal);
    out.albedo = floats(samples.albedo);
    out.color = floats(samples.color);
    out.footprint_m = samples.footprint_m.data();
    out.spacing_m = samples.spacing_m.data();
    out.cosine = samples.cosine.data();
    out.object_id = samples.object_id.data();
    out.camera = samples.camera.data();
    out.depth_m = round_.depth_m.data();
    out.heights = content_heights(samples);
    return out;
  }

 private:
  SampledRound round_;
};

}  // namespace

std::unique_ptr<Sampler> make_sampler(Device backend, const RoundSizes& expected) {
  if (backend == Device::Cpu) return std::make_unique<CpuSampler>();
#ifdef SPLATBUS_HAVE_CUDA
  return make_cuda_sampler(expected);
#else
  static_cast<void>(expected);
  throw std::runtime_error("this build samples on the CPU alone");
#endif
}

}  // namespace splatbus::capture_bridge
