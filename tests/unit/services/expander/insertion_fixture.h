#pragma once

#include <gtest/gtest.h>

#include <memory>
#include <set>
#include <utility>
#include <vector>

#include "bus/backend.h"
#include "bus/error.h"
#include "bus/memory.h"
#include "bus/slab_memory.h"
#include "expander/gaussian_inserter.h"
#include "sample_scene.h"

namespace splatbus::expander::test {

inline bool has_device(Device device) {
  try {
    (void)bus::choose_backend(name_of(device));
    return true;
  } catch (const bus::Error&) {
    return false;
  }
}

/// A round's tensors one after the other in one slot of a slab, as a capture-bridge leaves them.
class SentRound {
 public:
  SentRound(const HostRound& round, Device kind) : round_(incoming(round)) {
    const bus::SlabDescriptor descriptor{
        .id = 1, .name = "bridge/input", .kind = kind, .slots = 1, .slot_bytes = round.size() * kSampleBytes + 4096};
    slab_ = bus::create_slab_memory(descriptor, false);
    slab_->begin_write(0);
    std::size_t end = 0;
    std::vector<std::size_t> offsets;
    for (const bus::TensorView& tensor : round_.tensors) {
      bus::copy_memory(slab_->slot_data(0) + end, kind, tensor.data(), Device::Cpu, tensor.bytes());
      offsets.push_back(end);
      end += (tensor.bytes() + 63) / 64 * 64;
    }
    if (kind == Device::Cuda) bus::finish_copies();
    const std::uint64_t generation = slab_->end_write(0);
    for (std::size_t i = 0; i < offsets.size(); ++i) {
      const bus::TensorView tensor = round_.tensors[i];
      round_.tensors[i] = bus::TensorView(tensor.name(), {tensor.shape().begin(), tensor.shape().end()}, tensor.type(),
                                          slab_, slab_->span(0, offsets[i], tensor.bytes(), generation));
    }
  }

  [[nodiscard]] const IncomingRound& round() const { return round_; }
  void overwrite() { slab_->begin_write(0); }

 private:
  IncomingRound round_;
  std::shared_ptr<bus::Slab> slab_;
};

/// Insertion on a device; skipped where the machine does not have it.
class InsertionTest : public testing::TestWithParam<Device> {
 protected:
  void SetUp() override {
    if (!has_device(GetParam())) GTEST_SKIP() << "no " << name_of(GetParam());
    use_cells_of(kCellSize_m);
  }

  void use_cells_of(float size_m) { inserter_ = std::make_unique<GaussianInserter>(GetParam(), size_m); }

  HostGaussians insert(const HostRound& round) {
    const auto taken = inserter_->take(incoming(round));
    result_ = inserter_->insert(*taken, viewpoints_, options_);
    return on_host(result_.batches);
  }

  std::unique_ptr<GaussianInserter> inserter_;
  InsertOptions options_;
  std::vector<Viewpoint> viewpoints_;
  InsertResult result_;  // of the last round
};

inline std::string device_name(const testing::TestParamInfo<Device>& info) {
  return name_of(info.param);
}

}  // namespace splatbus::expander::test
