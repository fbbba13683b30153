#include "stream/cuda/cuda_observer.h"

#include <algorithm>
#include <cassert>
#include <limits>
#include <optional>

#include "device/buffer.h"
#include "device/pinned.h"
#include "device/stream.h"
#include "stream/cuda/observe_kernels.h"

namespace splatbus::stream {

namespace {

static_assert(kMaxGaussians <= std::size_t{1} << cuda::kChannelShift);

constexpr std::size_t kListedShare = 8;  // of all values one in so many is listed; beyond, all are brought over

cuda::Coding coding_of(Attribute attribute) {
  switch (attribute) {
    case Attribute::Rotation:
      return cuda::Coding::Rotation;
    case Attribute::Normal:
      return cuda::Coding::Normal;
    case Attribute::Opacity:
      return cuda::Coding::Opacity;
    case Attribute::Albedo:
      return cuda::Coding::Albedo;
    case Attribute::Visibility:
      return cuda::Coding::Visibility;
    default:
      return cuda::Coding::Plain;
  }
}

/// Where the planes of a layout are kept: in 16 bits where they fit.
struct Storage {
  explicit Storage(const StreamLayout& stream_layout) : layout(stream_layout) {
    for (const AttributeChannels& a : layout.attributes()) {
      const bool is_wide =
          a.minimum < std::numeric_limits<std::int16_t>::min() || a.maximum > std::numeric_limits<std::int16_t>::max();
      int& rows = is_wide ? wide : narrow;
      const cuda::Coding coding = coding_of(a.attribute);
      const bool together = coding == cuda::Coding::Rotation || coding == cuda::Coding::Normal;
      for (int c = 0; c < (together ? 1 : a.channels); ++c) {
        assert(plans.count < cuda::kMaxPlans);
        plans.plan[plans.count++] = {.step = step_of(a),
                                     .unit = a.quantizer.step,
                                     .coding = coding,
                                     .source = static_cast<std::int16_t>(parameter_channel(a.attribute) + c),
                                     .first = static_cast<std::int16_t>(a.first + c),
                                     .storage = static_cast<std::int16_t>(rows + c),
                                     .is_wide = is_wide};
      }
      for (int c = 0; c < a.channels; ++c) rows_of_channel.push_back({rows + c, is_wide});
      rows += a.channels;
    }
  }

  struct Row {
    int row;
    bool is_wide;
  };
  StreamLayout layout;
  cuda::Plans plans;
  std::vector<Row> rows_of_channel;
  int wide = 0, narrow = 0;
};

cuda::ModelPlanes planes_of(const GaussiansView& view) {
  const bool transfer = view.layout.appearance == Appearance::Transfer;
  return {.count = view.count,
          .stride = view.stride,
          .channels = view.layout.channels(),
          .parameters = view.parameters,
          .normal = transfer ? view.normal : nullptr,
          .visibility = transfer ? view.visibility : nullptr,
          .object_id = view.object_id,
          .gaussian_id = view.gaussian_id};
}

/// With room to spare: models grow in small steps, and making memory is slow.
template <class Array>
void make_room(Array& array, std::size_t elements) {
  if (array.size() < elements) array.resize(elements + elements / 2);
}

class CudaQuantizer final : public ModelQuantizer {
 public:
  float choose_mean_step(const GaussiansView& gaussians) override {
    make_room(extents_, gaussians.count);
    cuda::launch_extents(planes_of(gaussians), extents_.data(), counts_.data(), stream_.get());
    const std::uint32_t finite = read_counts().finite_extents;
    if (finite == 0) return kDefaultMeanStep_m;
    float median = 0;
    bring(&median, extents_.data() + finite / 2, 1);
    stream_.wait();
    return mean_step_for(median);
  }

  std::span<const std::uint64_t> ids(const GaussiansView& gaussians) override {
    const std::size_t count = gaussians.count;
    const bool another_count = count != ids_.size();
    make_room(gaussian_id_, count);
    cuda::launch_ids(planes_of(gaussians), integers(), counts_.data(), stream_.get());
    if (read_counts().ids > 0 || another_count) {
      ids_.resize(count);
      bring(ids_.data(), gaussian_id_.data(), count);
      stream_.wait();
      ids_moved_ = true;
    }
    return ids_;
  }

  void quantize(const GaussiansView& gaussians, const StreamLayout& layout, const QuantizedGaussians* held,
                std::span<const std::uint32_t> held_column) override {
    assert(ids_.size() == gaussians.count);
    // What an observation that was not committed has written over is in nobody's memory.
    const bool whole = pending_ || !storage_ || storage_->layout != layout || count_ != gaussians.count;
    if (!storage_ || storage_->layout != layout) storage_.emplace(layout);
    count_ = gaussians.count;
    const std::size_t values = storage_->rows_of_channel.size() * count_;
    const std::size_t capacity = values / kListedShare;
    make_room(wide_, static_cast<std::size_t>(storage_->wide) * count_);
    make_room(narrow_, static_cast<std::size_t>(storage_->narrow) * count_);
    make_room(usable_, count_);
    make_room(object_id_, count_);
    make_room(changes_, capacity);
    pending_ = true;

    cuda::launch_quantize(planes_of(gaussians), storage_->plans, upload_held(layout, held, held_column), integers(),
                          changes_.data(), static_cast<std::uint32_t>(capacity), counts_.data(), stream_.get());
    read_ = read_counts();
    all_ = whole || read_.values > capacity;
    if (whole) read_.usable = read_.object_ids = 1;
    bring_over();
  }

  void commit(QuantizedGaussians& target, std::vector<std::uint8_t>& usable) override {
    assert(pending_);
    pending_ = false;
    if (all_) {
      unpack(target);
    } else {
      for (std::size_t k = 0; k < read_.values; ++k) {
        const auto [where, value] = host_changes_[k];
        target.channels[where >> cuda::kChannelShift][where & ((1U << cuda::kChannelShift) - 1)] = value;
      }
    }
    if (read_.usable > 0) usable.assign(host_usable_.data(), host_usable_.data() + count_);
    if (read_.object_ids > 0) target.object_id.assign(host_object_id_.data(), host_object_id_.data() + count_);
    if (ids_moved_) target.gaussian_id = ids_;
    ids_moved_ = false;
  }

  [[nodiscard]] std::uint64_t copied_bytes() const override { return copied_bytes_; }

 private:
  [[nodiscard]] cuda::Integers integers() const {
    return {.wide = wide_.data(),
            .narrow = narrow_.data(),
            .usable = usable_.data(),
            .object_id = object_id_.data(),
            .gaussian_id = gaussian_id_.data()};
  }

  cuda::ObservedCounts read_counts() {
    counts_.download(host_counts_.data(), 1, stream_.get());
    stream_.wait();
    return host_counts_[0];
  }

  template <class T>
  void bring(T* host, const T* from, std::size_t elements) {
    device::check(cudaMemcpyAsync(host, from, elements * sizeof(T), cudaMemcpyDeviceToHost, stream_.get()),
                  "bringing over what was observed");
    copied_bytes_ += elements * sizeof(T);
  }

  template <class T>
  void bring(device::Pinned<T>& host, const device::Buffer<T>& from, std::size_t elements) {
    make_room(host, elements);
    if (elements > 0) bring(host.data(), from.data(), elements);
  }

  void bring_over() {
    if (all_) {
      bring(host_wide_, wide_, static_cast<std::size_t>(storage_->wide) * count_);
      bring(host_narrow_, narrow_, static_cast<std::size_t>(storage_->narrow) * count_);
    } else {
      bring(host_changes_, changes_, read_.values);
    }
    if (read_.usable > 0) bring(host_usable_, usable_, count_);
    if (read_.object_ids > 0) bring(host_object_id_, object_id_, count_);
    stream_.wait();
  }

  /// Null when nothing is held.
  const cuda::HeldRotation* upload_held(const StreamLayout& layout, const QuantizedGaussians* held,
                                        std::span<const std::uint32_t> held_column) {
    if (held == nullptr || count_ == 0) return nullptr;
    assert(held_column.size() == count_);
    const auto first = static_cast<std::size_t>(layout.at(Attribute::Rotation).first);
    const std::int32_t *x = held->channels[first].data(), *y = held->channels[first + 1].data(),
                       *z = held->channels[first + 2].data();
    make_room(host_held_, count_);
    for (std::size_t i = 0; i < count_; ++i) {
      const std::uint32_t column = held_column[i];
      host_held_[i] = column == kNotHeld ? cuda::HeldRotation{}
                                         : cuda::HeldRotation{static_cast<std::int16_t>(x[column]),
                                                              static_cast<std::int16_t>(y[column]),
                                                              static_cast<std::int16_t>(z[column]), 1};
    }
    make_room(held_, count_);
    device::check(cudaMemcpyAsync(held_.data(), host_held_.data(), count_ * sizeof(cuda::HeldRotation),
                                  cudaMemcpyHostToDevice, stream_.get()),
                  "copying held rotations");
    return held_.data();
  }

  void unpack(QuantizedGaussians& target) const {
    target.channels.resize(storage_->rows_of_channel.size());
    target.resize(count_);
    for (std::size_t channel = 0; channel < target.channels.size(); ++channel) {
      const auto [row, is_wide] = storage_->rows_of_channel[channel];
      const std::size_t first = static_cast<std::size_t>(row) * count_;
      if (is_wide) {
        std::copy_n(host_wide_.data() + first, count_, target.channels[channel].begin());
      } else {
        std::copy_n(host_narrow_.data() + first, count_, target.channels[channel].begin());
      }
    }
  }

  device::Stream stream_;
  std::optional<Storage> storage_;
  std::size_t count_ = 0;
  bool pending_ = false;    ///< quantized and not committed
  bool all_ = false;        ///< the last quantize() brought every value over
  bool ids_moved_ = false;  ///< since the last commit
  cuda::ObservedCounts read_{};
  std::uint64_t copied_bytes_ = 0;

  device::Buffer<float> extents_;
  device::Buffer<cuda::ObservedCounts> counts_{1};
  device::Buffer<std::int32_t> wide_;
  device::Buffer<std::int16_t> narrow_;
  device::Buffer<std::uint8_t> usable_;
  device::Buffer<std::uint32_t> object_id_;
  device::Buffer<std::uint64_t> gaussian_id_;
  device::Buffer<cuda::ValueChange> changes_;
  device::Buffer<cuda::HeldRotation> held_;

  device::Pinned<cuda::ObservedCounts> host_counts_{1};
  device::Pinned<std::int32_t> host_wide_;
  device::Pinned<std::int16_t> host_narrow_;
  device::Pinned<std::uint8_t> host_usable_;
  device::Pinned<std::uint32_t> host_object_id_;
  device::Pinned<cuda::ValueChange> host_changes_;
  device::Pinned<cuda::HeldRotation> host_held_;
  std::vector<std::uint64_t> ids_;
};

}  // namespace

std::unique_ptr<ModelQuantizer> make_cuda_quantizer() {
  return std::make_unique<CudaQuantizer>();
}

}  // namespace splatbus::stream
