#include "stream/model_quantizer.h"

#include <algorithm>
#include <cassert>
#include <limits>
#include <optional>

#include "device/buffer.h"
#include "device/stream.h"
#include "stream/channel_kernels.h"
#include "stream/pieces.h"
#ifdef SPLATBUS_HAVE_CUDA
#include "device/pinned.h"
#endif

namespace splatbus::stream {

namespace {

static_assert(kMaxModelGaussians <= std::size_t{1} << kernels::kChannelShift);

constexpr std::size_t kListedShare = 8;  // of all values one in so many is listed; beyond, all are brought over

/// Where the channels of a layout are kept: in 16 bits where they fit.
struct Storage {
  explicit Storage(const StreamLayout& stream_layout) : layout(stream_layout) {
    for (const AttributeChannels& a : layout.attributes()) {
      const bool is_wide =
          a.minimum < std::numeric_limits<std::int16_t>::min() || a.maximum > std::numeric_limits<std::int16_t>::max();
      int& rows = is_wide ? wide : narrow;
      const coding::Kind kind = coding_of(a.attribute);
      const bool together = kind == coding::Kind::Rotation || kind == coding::Kind::Normal;
      for (int c = 0; c < (together ? 1 : a.channels); ++c) {
        assert(plans.count < kernels::kMaxPlans);
        plans.plan[plans.count++] = {.step = step_of(a),
                                     .unit = a.quantizer.step,
                                     .kind = kind,
                                     .source = static_cast<std::int16_t>(parameter_channel(a.attribute) + c),
                                     .first = static_cast<std::int16_t>(a.first + c),
                                     .storage = static_cast<std::int16_t>(rows + c),
                                     .is_wide = is_wide};
      }
      for (int c = 0; c < a.channels; ++c) row_of_channel.push_back({rows + c, is_wide});
      rows += a.channels;
    }
  }

  struct Row {
    int row;
    bool is_wide;
  };
  StreamLayout layout;
  kernels::Plans plans;
  std::vector<Row> row_of_channel;
  int wide = 0, narrow = 0;
};

/// With room to spare: models grow in small steps, and making memory is slow.
template <class Array>
void make_room(Array& array, std::size_t elements) {
  if (array.size() < elements) array.resize(elements + elements / 2);
}

/// What a device's memory holds, for the host to read: on the CPU it is that memory itself.
template <class T>
class HostCopy {
 public:
  explicit HostCopy(device::StreamView stream) : stream_(stream) {}

  /// Enqueued. Valid until the memory changes, or the next call.
  const T* bring(const T* from, std::size_t elements) {
#ifdef SPLATBUS_HAVE_CUDA
    if (stream_.on_cuda()) {
      make_room(memory_, elements);
      device::copy(stream_, memory_.data(), from, elements * sizeof(T));
      copied_bytes_ += elements * sizeof(T);
      return data_ = memory_.data();
    }
#endif
    static_cast<void>(elements);
    return data_ = from;
  }
  [[nodiscard]] const T* data() const {
    return data_;
  }
  [[nodiscard]] const T& operator[](std::size_t i) const {
    return data_[i];
  }
  [[nodiscard]] std::uint64_t copied_bytes() const {
    return copied_bytes_;
  }

 private:
  device::StreamView stream_;
  const T* data_ = nullptr;
  std::uint64_t copied_bytes_ = 0;
#ifdef SPLATBUS_HAVE_CUDA
  device::Pinned<T> memory_;
#endif
};

}  // namespace

class ModelQuantizer::Impl {
 public:
  explicit Impl(Device device) : stream_(device) {}

  float choose_mean_step(const GaussiansView& gaussians) {
    const kernels::ModelChannels channels = channels_of(gaussians);
    make_room(extents_, channels.count);
    const std::uint32_t finite = kernels::sort_extents(channels, extents_.data(), stream_);
    if (finite == 0) return kDefaultMeanStep_m;
    float median = 0;
    device::copy(stream_, &median, extents_.data() + finite / 2, sizeof(median));
    stream_.wait();
    return mean_step_for(median);
  }

  std::span<const std::uint64_t> ids(const GaussiansView& gaussians) {
    const kernels::ModelChannels channels = channels_of(gaussians);
    const std::size_t count = channels.count;
    const bool another_count = count != ids_.size();
    make_room(gaussian_id_, count);
    counts_.clear();
    kernels::take_ids(channels, integers(), counts_.data(), stream_);
    if (read_counts().ids > 0 || another_count) {
      const std::uint64_t* ids = host_ids_.bring(gaussian_id_.data(), count);
      stream_.wait();
      ids_.assign(ids, ids + count);
      ids_moved_ = true;
    }
    return ids_;
  }

  void quantize(const GaussiansView& gaussians, const StreamLayout& layout, const HeldGaussians* held,
                std::span<const std::uint32_t> held_column) {
    const kernels::ModelChannels channels = channels_of(gaussians);
    assert(ids_.size() == channels.count && layout.carries(gaussians.layout));
    // What an observation that was not committed has written over is in nobody's memory.
    const bool whole = pending_ || !storage_ || storage_->layout != layout || count_ != channels.count;
    if (!storage_ || storage_->layout != layout) storage_.emplace(layout);
    count_ = channels.count;
    const std::size_t capacity = whole ? 0 : storage_->row_of_channel.size() * count_ / kListedShare;
    make_room(wide_, static_cast<std::size_t>(storage_->wide) * count_);
    make_room(narrow_, static_cast<std::size_t>(storage_->narrow) * count_);
    make_room(usable_, count_);
    make_room(object_id_, count_);
    make_room(changes_, capacity);
    pending_ = true;

    counts_.clear();
    kernels::quantize(channels, storage_->plans, upload_held(layout, held, held_column), integers(),
                      {changes_.data(), static_cast<std::uint32_t>(capacity), counts_.data()}, stream_);
    read_ = read_counts();
    all_ = capacity == 0 || read_.values > capacity;
    if (whole) read_.usable = read_.object_ids = 1;
    bring_over();
  }

  void commit(QuantizedGaussians& target, std::vector<std::uint8_t>& usable) {
    assert(pending_);
    pending_ = false;
    if (all_) {
      unpack(target);
    } else {
      for (std::size_t k = 0; k < read_.values; ++k) {
        const auto [where, value] = host_changes_[k];
        target.channels[where >> kernels::kChannelShift][where & ((1U << kernels::kChannelShift) - 1)] = value;
      }
    }
    if (read_.usable > 0) usable.assign(host_usable_.data(), host_usable_.data() + count_);
    if (read_.object_ids > 0) target.object_id.assign(host_object_id_.data(), host_object_id_.data() + count_);
    if (ids_moved_) target.gaussian_id = ids_;
    ids_moved_ = false;
  }

  [[nodiscard]] std::uint64_t copied_bytes() const {
    return host_wide_.copied_bytes() + host_narrow_.copied_bytes() + host_usable_.copied_bytes() +
           host_object_id_.copied_bytes() + host_changes_.copied_bytes() + host_ids_.copied_bytes();
  }

 private:
  kernels::ModelChannels channels_of(const GaussiansView& view) {
    list_blocks(view);
    const bool transfer = view.layout.appearance == Appearance::Transfer;
    return {.count = columns_,
            .blocks = blocks_.data(),
            .block_count = static_cast<std::uint32_t>(blocks_.size()),
            .stride = view.stride,
            .page_shift = view.page_shift,
            .page_stride = view.page_stride,
            .channels = view.layout.channels(),
            .parameters = view.parameters,
            .normal = transfer ? view.normal : nullptr,
            .visibility = transfer ? view.visibility : nullptr,
            .object_id = view.object_id,
            .gaussian_id = view.gaussian_id};
  }

  /// The columns are the Gaussians in the order of their indices.
  void list_blocks(const GaussiansView& view) {
    const IndexRange all{.first = 0, .count = static_cast<std::uint32_t>(view.count)};
    const std::span<const IndexRange> ranges = view.has_pages() ? view.ranges : std::span(&all, 1);
    if (std::ranges::equal(ranges, ranges_)) return;
    ranges_.assign(ranges.begin(), ranges.end());
    host_blocks_.clear();
    columns_ = 0;
    const std::uint32_t most = stream_.view().on_cuda() ? kernels::kDeviceBlock : kernels::kHostBlock;
    for (const IndexRange& range : ranges_) {
      for (std::uint32_t k = 0; k < range.count; k += most) {
        const std::uint32_t size = std::min(most, range.count - k);
        host_blocks_.push_back({.first = columns_, .size = size, .index = range.first + k, .frame_id = range.frame_id});
        columns_ += size;
      }
    }
    blocks_.assign(host_blocks_);
    stream_.wait();
  }

  [[nodiscard]] kernels::Integers integers() const {
    return {.wide = wide_.data(),
            .narrow = narrow_.data(),
            .usable = usable_.data(),
            .object_id = object_id_.data(),
            .gaussian_id = gaussian_id_.data()};
  }

  kernels::ObservedCounts read_counts() {
    kernels::ObservedCounts counts{};
    device::copy(stream_, &counts, counts_.data(), sizeof(counts));
    stream_.wait();
    return counts;
  }

  void bring_over() {
    if (all_) {
      host_wide_.bring(wide_.data(), static_cast<std::size_t>(storage_->wide) * count_);
      host_narrow_.bring(narrow_.data(), static_cast<std::size_t>(storage_->narrow) * count_);
    } else {
      host_changes_.bring(changes_.data(), read_.values);
    }
    if (read_.usable > 0) host_usable_.bring(usable_.data(), count_);
    if (read_.object_ids > 0) host_object_id_.bring(object_id_.data(), count_);
    stream_.wait();
  }

  /// Null when nothing is held.
  const kernels::HeldRotation* upload_held(const StreamLayout& layout, const HeldGaussians* held,
                                           std::span<const std::uint32_t> held_column) {
    if (held == nullptr || count_ == 0) return nullptr;
    assert(held_column.size() == count_);
    const auto first = static_cast<std::size_t>(layout.at(Attribute::Rotation).first);
    const HeldChannel &x = held->channels[first], &y = held->channels[first + 1], &z = held->channels[first + 2];
    host_held_.resize(count_);
    for_each_at_once(count_, [&](std::size_t i) {
      const std::uint32_t column = held_column[i];
      host_held_[i] = column == kNotHeld ? kernels::HeldRotation{}
                                         : kernels::HeldRotation{static_cast<std::int16_t>(x[column]),
                                                                 static_cast<std::int16_t>(y[column]),
                                                                 static_cast<std::int16_t>(z[column]), 1};
    });
    held_.assign(host_held_);
    return held_.data();
  }

  void unpack(QuantizedGaussians& target) const {
    target.channels.resize(storage_->row_of_channel.size());
    target.resize(count_);
    for_each_at_once(target.channels.size(), [&](std::size_t channel) {
      const auto [row, is_wide] = storage_->row_of_channel[channel];
      const std::size_t first = static_cast<std::size_t>(row) * count_;
      if (is_wide) {
        std::copy_n(host_wide_.data() + first, count_, target.channels[channel].begin());
      } else {
        std::copy_n(host_narrow_.data() + first, count_, target.channels[channel].begin());
      }
    });
  }

  device::Stream stream_;
  std::optional<Storage> storage_;
  std::size_t count_ = 0;
  bool pending_ = false;    ///< quantized and not committed
  bool all_ = false;        ///< the last quantize() brought every value over
  bool ids_moved_ = false;  ///< since the last commit
  kernels::ObservedCounts read_{};
  std::vector<std::uint64_t> ids_;
  std::vector<kernels::HeldRotation> host_held_;

  std::vector<IndexRange> ranges_;  ///< that the blocks are of
  std::vector<kernels::ColumnBlock> host_blocks_;
  std::uint32_t columns_ = 0;

  device::Buffer<kernels::ColumnBlock> blocks_{stream_};
  device::Buffer<float> extents_{stream_};
  device::Buffer<kernels::ObservedCounts> counts_{stream_, 1};
  device::Buffer<std::int32_t> wide_{stream_};
  device::Buffer<std::int16_t> narrow_{stream_};
  device::Buffer<std::uint8_t> usable_{stream_};
  device::Buffer<std::uint32_t> object_id_{stream_};
  device::Buffer<std::uint64_t> gaussian_id_{stream_};
  device::Buffer<kernels::ValueChange> changes_{stream_};
  device::Buffer<kernels::HeldRotation> held_{stream_};

  HostCopy<std::int32_t> host_wide_{stream_};
  HostCopy<std::int16_t> host_narrow_{stream_};
  HostCopy<std::uint8_t> host_usable_{stream_};
  HostCopy<std::uint32_t> host_object_id_{stream_};
  HostCopy<kernels::ValueChange> host_changes_{stream_};
  HostCopy<std::uint64_t> host_ids_{stream_};
};

ModelQuantizer::ModelQuantizer(Device device) : impl_(std::make_unique<Impl>(device)) {}
ModelQuantizer::~ModelQuantizer() = default;
ModelQuantizer::ModelQuantizer(ModelQuantizer&&) noexcept = default;

float ModelQuantizer::choose_mean_step(const GaussiansView& gaussians) {
  return impl_->choose_mean_step(gaussians);
}

std::span<const std::uint64_t> ModelQuantizer::ids(const GaussiansView& gaussians) {
  return impl_->ids(gaussians);
}

void ModelQuantizer::quantize(const GaussiansView& gaussians, const StreamLayout& layout, const HeldGaussians* held,
                              std::span<const std::uint32_t> held_column) {
  impl_->quantize(gaussians, layout, held, held_column);
}

void ModelQuantizer::commit(QuantizedGaussians& target, std::vector<std::uint8_t>& usable) {
  impl_->commit(target, usable);
}

std::uint64_t ModelQuantizer::copied_bytes() const {
  return impl_->copied_bytes();
}

}  // namespace splatbus::stream
