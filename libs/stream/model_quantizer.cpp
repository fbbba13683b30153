#include "stream/model_quantizer.h"

#include <algorithm>
#include <cassert>
#include <numeric>
#include <utility>
#ifdef SPLATBUS_HAVE_CUDA
#include "stream/cuda/cuda_observer.h"
#endif

namespace splatbus::stream {

namespace {

class HostQuantizer final : public ModelQuantizer {
 public:
  float choose_mean_step(const GaussiansView& gaussians) override { return stream::choose_mean_step(gaussians); }

  std::span<const std::uint64_t> ids(const GaussiansView& gaussians) override {
    ids_.resize(gaussians.count);
    if (gaussians.gaussian_id) {
      std::copy_n(gaussians.gaussian_id, gaussians.count, ids_.begin());
    } else {
      std::iota(ids_.begin(), ids_.end(), std::uint64_t{1});
    }
    return ids_;
  }

  void quantize(const GaussiansView& gaussians, const StreamLayout& layout, const QuantizedGaussians* held,
                std::span<const std::uint32_t> held_column) override {
    stream::quantize(gaussians, layout, read_, usable_, held, held_column.data());
  }

  void commit(QuantizedGaussians& target, std::vector<std::uint8_t>& usable) override {
    read_.gaussian_id = ids_;
    std::swap(target, read_);
    std::swap(usable, usable_);
  }

 private:
  std::vector<std::uint64_t> ids_;
  QuantizedGaussians read_;
  std::vector<std::uint8_t> usable_;
};

}  // namespace

std::unique_ptr<ModelQuantizer> make_host_quantizer() {
  return std::make_unique<HostQuantizer>();
}

std::unique_ptr<ModelQuantizer> make_model_quantizer([[maybe_unused]] Device memory) {
#ifdef SPLATBUS_HAVE_CUDA
  if (memory == Device::Cuda) return make_cuda_quantizer();
#endif
  assert(memory == Device::Cpu);
  return make_host_quantizer();
}

}  // namespace splatbus::stream
