#include <algorithm>
#include <numeric>
#include <utility>

#include "stream/observer.h"

namespace splatbus::stream {

namespace {

class HostObserver final : public Observer {
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

  void quantise(const GaussiansView& gaussians, const StreamLayout& layout, const QuantisedGaussians* held,
                std::span<const std::uint32_t> held_column) override {
    stream::quantise(gaussians, layout, read_, usable_, held, held_column.data());
  }

  void commit(QuantisedGaussians& target, std::vector<std::uint8_t>& usable) override {
    read_.gaussian_id = ids_;
    std::swap(target, read_);
    std::swap(usable, usable_);
  }

 private:
  std::vector<std::uint64_t> ids_;
  QuantisedGaussians read_;
  std::vector<std::uint8_t> usable_;
};

}  // namespace

std::unique_ptr<Observer> make_host_observer() {
  return std::make_unique<HostObserver>();
}

}  // namespace splatbus::stream
