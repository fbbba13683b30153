#include "stream/display_gaussians.h"

#include <algorithm>
#include <cassert>
#include <map>

#include "stream/all_seen.h"
#include "stream/channel_kernels.h"
#include "stream/replicated_state.h"

namespace splatbus::stream {

namespace {

/// Host memory as the stream's device reads it.
template <class T>
const T* on_device(device::Buffer<T>& buffer, const std::vector<T>& host) {
  if (!buffer.stream().on_cuda()) return host.data();
  buffer.assign(host);
  return buffer.data();
}

/// Of whose bytes an opacity logit of -1574 is made: rows of it are not seen.
constexpr int kTransparentByte = 0xC4;
constexpr std::uint32_t kTransparent = 0x01010101U * kTransparentByte;
/// Changes as large as that are worth calls of their own; as much may be pending.
constexpr std::size_t kManyBytes = std::size_t{1} << 21;

}  // namespace

DisplayGaussians::DisplayGaussians(const StreamLayout& layout, device::StreamView stream)
    : layout_(layout),
      stream_(stream),
      row_count_(layout.parameters().channels() + (layout.parameters().appearance == Appearance::Transfer ? 4 : 0)),
      rows_(stream),
      object_id_(stream),
      seen_(stream),
      others_(stream),
      ids_(stream),
      columns_(stream),
      bytes_(stream),
      values_(stream) {
  for (const AttributeChannels& attribute : layout_.attributes()) {
    pending_values_.emplace_back(static_cast<std::size_t>(attribute.channels));
  }
}

int DisplayGaussians::row_of(Attribute attribute) const {
  const int channels = layout_.parameters().channels();
  if (attribute == Attribute::Normal) return channels;
  return attribute == Attribute::Visibility ? channels + 3 : parameter_channel(attribute);
}

void DisplayGaussians::reserve(std::size_t rows) {
  if (rows <= stride_) return;
  std::size_t stride = std::max({rows, 2 * stride_, std::size_t{4096}});
  stride = (stride + kPageLanes - 1) / kPageLanes * kPageLanes;
  device::Buffer<float> values(stream_, static_cast<std::size_t>(row_count_) * stride);
  device::fill(stream_, values.data(), kTransparentByte, values.bytes());
  for (int r = 0; r < row_count_; ++r) {
    device::copy(stream_, values.data() + static_cast<std::size_t>(r) * stride, row(r), stride_ * sizeof(float));
  }
  device::Buffer<std::uint32_t> object_id(stream_, stride);
  device::copy(stream_, object_id.data(), object_id_.data(), stride_ * sizeof(std::uint32_t));
  if (!lights_.empty()) {
    device::Buffer<std::uint8_t> seen(stream_);
    gather_lights(lights_, stride, seen);
    seen_ = std::move(seen);
  }
  rows_ = std::move(values);
  object_id_ = std::move(object_id);
  stride_ = stride;
}

void DisplayGaussians::apply(const DisplayChanges& changes) {
  for (const DisplayChange& change : changes.list()) {
    std::visit([this](const auto& c) { apply(c); }, change);
  }
  flush();
  list_ranges();
}

void DisplayGaussians::apply(const DisplayReset& change) {
  *this = DisplayGaussians(change.layout, stream_);
}

void DisplayGaussians::apply(const DisplayRows& change) {
  if (change.rows.empty()) return;
  reserve(std::size_t{1} + *std::ranges::max_element(change.rows));
  apply(DisplayObjects{change.rows, change.gaussians.object_id});
  for (const AttributeChannels& a : layout_.attributes()) {
    DisplayValues values{.attribute = a.attribute, .rows = change.rows, .values = {}};
    for (int c = a.first; c < a.first + a.channels; ++c) {
      const std::vector<std::int32_t>& plane = change.gaussians.channels[c];
      values.values.insert(values.values.end(), plane.begin(), plane.end());
    }
    if (a.attribute == Attribute::Visibility && !lights_.empty()) {
      apply(DisplaySeen{0, change.rows, Bytes(values.values.begin(), values.values.end())});
    }
    apply(values);
  }
}

template <class T, class Write>
void DisplayGaussians::gather(PendingRows<T>& pending, const std::vector<std::uint32_t>& rows,
                              const std::vector<T>& values, Write&& write) {
  const std::size_t bytes = rows.size() * sizeof(std::uint32_t) + values.size() * sizeof(T);
  const bool many = bytes >= kManyBytes;
  if (many || pending_bytes_ + bytes > kManyBytes || pending.any_of(rows)) flush();
  if (many) {
    write(rows, values);
    stream_.wait();
    return;
  }
  pending.add(rows, values);
  pending_bytes_ += bytes;
}

void DisplayGaussians::apply(const DisplayValues& change) {
  const AttributeChannels& a = layout_.at(change.attribute);
  assert(change.values.size() == static_cast<std::size_t>(a.channels) * change.rows.size());
  if (change.attribute == Attribute::Opacity && pending_hidden_.any_of(change.rows)) flush();
  gather(pending_values_[static_cast<std::size_t>(&a - layout_.attributes().data())], change.rows, change.values,
         [&](const auto& rows, const auto& values) { write_values(a, rows, values); });
}

void DisplayGaussians::apply(const DisplayObjects& change) {
  gather(pending_objects_, change.rows, change.object_ids,
         [this](const auto& rows, const auto& ids) { write_objects(rows, ids); });
}

void DisplayGaussians::apply(const DisplayBlocks& change) {
  // A block that one page has left may be another's by the end of the change, with rows that are there already.
  std::map<std::uint32_t, std::uint32_t> before;
  for (const auto& [block, count] : change.blocks) {
    if (block >= block_counts_.size()) block_counts_.resize(std::size_t{block} + 1);
    reserve((std::size_t{block} + 1) * kBlockRows);
    before.try_emplace(block, block_counts_[block]);
    block_counts_[block] = count;
  }
  for (const auto& [block, shown] : before) {
    for (std::uint32_t row = block_counts_[block]; row < shown; ++row) {
      const std::uint32_t hidden[] = {block * kBlockRows + row}, opacity[] = {kTransparent};
      if (!pending_hidden_.any_of(hidden)) pending_hidden_.add(hidden, opacity);
    }
  }
}

void DisplayGaussians::list_ranges() {
  count_ = 0;
  ranges_.clear();
  for (std::uint32_t block = 0; block < block_counts_.size(); ++block) {
    if (block_counts_[block] == 0) continue;
    const std::uint32_t begin = block * kBlockRows, end = begin + block_counts_[block];
    const std::uint32_t page = begin >> kPageShift << kPageShift;
    if (ranges_.empty() || ranges_.back().first < page) ranges_.push_back({.first = begin, .count = 0});
    ranges_.back().count = end - ranges_.back().first;
    count_ += block_counts_[block];
  }
}

std::uint8_t* DisplayGaussians::seen_row(std::uint32_t light_id) const {
  const auto found = std::ranges::find(lights_, light_id);
  const auto index = light_id == 0 ? 0 : static_cast<std::size_t>(found - lights_.begin()) + 1;
  assert(light_id == 0 || found != lights_.end());
  return seen_.data() + index * stride_;
}

void DisplayGaussians::gather_lights(const std::vector<std::uint32_t>& ids, std::size_t stride,
                                     device::Buffer<std::uint8_t>& to) {
  to.resize((1 + ids.size()) * stride);
  if (to.empty()) return;
  device::fill(stream_, to.data(), kAllSeen, to.bytes());
  if (!lights_.empty()) device::copy(stream_, to.data(), seen_row(0), stride_);
  for (std::size_t k = 0; k < ids.size(); ++k) {
    if (!std::ranges::binary_search(lights_, ids[k])) continue;
    device::copy(stream_, to.data() + (k + 1) * stride, seen_row(ids[k]), stride_);
  }
}

void DisplayGaussians::apply(const DisplayLights& change) {
  flush();
  pending_seen_.clear();
  device::Buffer<std::uint8_t> seen(stream_);
  if (!change.ids.empty()) gather_lights(change.ids, stride_, seen);
  stream_.wait();
  seen_ = std::move(seen);
  lights_ = change.ids;
}

void DisplayGaussians::apply(const DisplaySeen& change) {
  gather(pending_seen_.try_emplace(change.light_id).first->second, change.rows, change.values,
         [&](const auto& rows, const auto& seen) { write_seen(change.light_id, rows, seen); });
}

void DisplayGaussians::flush() {
  // The device may read them until it is waited for.
  std::vector<std::vector<std::int32_t>> values;
  std::vector<Bytes> seen;
  for (std::size_t k = 0; k < pending_values_.size(); ++k) {
    const auto& pending = pending_values_[k];
    if (!pending.empty()) write_values(layout_.attributes()[k], pending.rows(), values.emplace_back(pending.values()));
  }
  const std::vector<std::uint32_t> objects = pending_objects_.values(), hidden = pending_hidden_.values();
  if (!objects.empty()) write_objects(pending_objects_.rows(), objects);
  for (const auto& [light_id, pending] : pending_seen_) {
    if (!pending.empty()) write_seen(light_id, pending.rows(), seen.emplace_back(pending.values()));
  }
  if (!hidden.empty()) {
    auto* const opacity = reinterpret_cast<std::uint32_t*>(row(row_of(Attribute::Opacity)));
    kernels::scatter(on_device(ids_, hidden), on_device(columns_, pending_hidden_.rows()),
                     static_cast<std::uint32_t>(hidden.size()), opacity, stream_);
  }
  stream_.wait();
  for (auto& pending : pending_values_) pending.clear();
  pending_objects_.clear();
  for (auto& [light_id, pending] : pending_seen_) pending.clear();
  pending_hidden_.clear();
  pending_bytes_ = 0;
}

void DisplayGaussians::write_values(const AttributeChannels& attribute, const std::vector<std::uint32_t>& rows,
                                    const std::vector<std::int32_t>& values) {
  kernels::dequantize({.offset = attribute.quantizer.offset,
                       .step = attribute.quantizer.step,
                       .kind = coding_of(attribute.attribute),
                       .channels = attribute.channels,
                       .row = row_of(attribute.attribute)},
                      on_device(values_, values), on_device(columns_, rows), static_cast<std::uint32_t>(rows.size()),
                      rows_.data(), stride_, stream_);
}

void DisplayGaussians::write_objects(const std::vector<std::uint32_t>& rows, const std::vector<std::uint32_t>& ids) {
  kernels::scatter(on_device(ids_, ids), on_device(columns_, rows), static_cast<std::uint32_t>(rows.size()),
                   object_id_.data(), stream_);
}

void DisplayGaussians::write_seen(std::uint32_t light_id, const std::vector<std::uint32_t>& rows, const Bytes& seen) {
  kernels::scatter(on_device(bytes_, seen), on_device(columns_, rows), static_cast<std::uint32_t>(rows.size()),
                   seen_row(light_id), stream_);
}

GaussiansView DisplayGaussians::view() const {
  GaussiansView view;
  view.layout = layout_.parameters();
  view.count = ranges_.empty() ? 0 : ranges_.back().first + ranges_.back().count;
  view.stride = stride_;
  view.page_shift = kPageShift;
  view.page_stride = kPageLanes;
  view.ranges = ranges_;
  view.parameters = rows_.data();
  view.object_id = object_id_.data();
  if (view.layout.appearance == Appearance::Transfer && !rows_.empty()) {
    view.normal = row(row_of(Attribute::Normal));
    view.visibility = row(row_of(Attribute::Visibility));
    if (!lights_.empty()) {
      view.visibility_u8 = seen_.data();
      view.visibility_stride = stride_;
      view.visibility_rows = static_cast<std::uint32_t>(1 + lights_.size());
    }
  }
  return view;
}

GaussiansView DisplayGaussians::view(const std::vector<LightSource>& sources) {
  std::vector<std::uint32_t> ids;
  ids.reserve(sources.size());
  for (const LightSource& source : sources) ids.push_back(source.id);
  GaussiansView out = view();
  if (ids == lights_ || out.visibility_u8 == nullptr) return out;
  gather_lights(ids, stride_, others_);
  stream_.wait();
  out.visibility_u8 = others_.data();
  out.visibility_rows = static_cast<std::uint32_t>(1 + ids.size());
  return out;
}

}  // namespace splatbus::stream
