#include "wire/published_model.h"

#include <algorithm>
#include <string>
#include <utility>

#include "bus/error.h"
#include "bus/memory.h"
#include "bus/tensor.h"
#include "wire/model_generated.h"

namespace splatbus {

namespace {

constexpr std::uint64_t kCapacityLimit = std::uint64_t{1} << 26;

[[noreturn]] void reject(const bus::Message& message, const std::string& what) {
  throw bus::Error(message.topic() + " from " + message.header().source()->str() + ": " + what);
}

ParameterLayout layout_of(const bus::Message& message, const wire::ModelPublished& published) {
  ParameterLayout layout;
  switch (published.appearance()) {
    case wire::Appearance::Transfer:
      layout.appearance = Appearance::Transfer;
      return layout;
    case wire::Appearance::Radiance:
      if (published.sh_degree() > 3) {
        reject(message, "SH degree " + std::to_string(published.sh_degree()) + " is above 3");
      }
      layout.appearance = Appearance::Radiance;
      layout.sh_degree = published.sh_degree();
      return layout;
  }
  reject(message, "unknown appearance " + std::to_string(static_cast<int>(published.appearance())));
}

/// The tensor of a plane, nullopt when it lies in a slab, or a generation of it, that is gone.
std::optional<bus::TensorView> find_plane(const bus::Message& message, const char* name, bus::ElementType type,
                                          std::uint32_t channels, std::uint32_t capacity) {
  auto view = channels == 0 ? message.tensor(name, type, {capacity}) : message.tensor(name, type, {channels, capacity});
  if (!view && !message.announces(name)) reject(message, std::string("plane \"") + name + "\" is missing");
  return view;
}

}  // namespace

std::optional<PublishedModel> PublishedModel::open(const bus::Message& message, Device kind, Need need) {
  const auto& published = message.root<wire::ModelPublished>();
  if (published.capacity() == 0 || published.capacity() > kCapacityLimit) {
    reject(message, "capacity " + std::to_string(published.capacity()) + " is not within 1 and " +
                        std::to_string(kCapacityLimit));
  }
  if (published.count() > published.capacity()) {
    reject(message,
           "count " + std::to_string(published.count()) + " exceeds capacity " + std::to_string(published.capacity()));
  }

  PublishedModel model;
  model.kind_ = kind;
  model.generation_ = published.generation();
  model.step_ = published.step();
  GaussiansView& live = model.live_;
  live.layout = layout_of(message, published);
  live.count = published.count();
  live.stride = published.capacity();

  bool lost = false, elsewhere = false;
  const auto add = [&](const char* name, bus::ElementType type, std::uint32_t channels) {
    auto plane = find_plane(message, name, type, channels, static_cast<std::uint32_t>(published.capacity()));
    lost |= !plane;
    if (!plane) return;
    if (!model.planes_.empty() && !plane->shares_validity(model.planes_.front().source)) {
      reject(message, std::string("plane \"") + name + "\" lies in another slot than plane \"" +
                          model.planes_.front().source.name() + "\": one sequence lock guards all planes");
    }
    elsewhere |= plane->memory() != kind;
    model.planes_.push_back(
        {.source = std::move(*plane), .channels = std::max(1U, channels), .element_bytes = bus::element_bytes(type)});
  };
  const auto channels = static_cast<std::uint32_t>(live.layout.channels());
  add("average", bus::ElementType::F32, channels);
  add("normal", bus::ElementType::F32, 3);
  add("surface_point", bus::ElementType::F32, 3);
  add("visibility", bus::ElementType::F32, 0);
  add("object_id", bus::ElementType::U32, 0);
  add("flags", bus::ElementType::U32, 0);
  add("cell", bus::ElementType::U64, 0);
  add("gaussian_id", bus::ElementType::U64, 0);
  if (need == Need::Both) add("parameters", bus::ElementType::F32, channels);
  if (lost) return std::nullopt;

  if (elsewhere) {
    live.stride = std::max<std::size_t>(live.count, 1);
    std::size_t bytes = 0;
    for (Plane& plane : model.planes_) {
      plane.copied_at = bytes;
      bytes += bus::aligned(plane.channels * live.stride * plane.element_bytes);
    }
    model.copies_ = bus::allocate_memory(kind, bytes);
  }
  const auto at = [&](std::size_t index) {
    const Plane& plane = model.planes_[index];
    return elsewhere ? model.copies_.get() + plane.copied_at : plane.source.data();
  };
  const auto* const average = reinterpret_cast<const float*>(at(0));
  live.normal = reinterpret_cast<const float*>(at(1));
  live.surface_point = reinterpret_cast<const float*>(at(2));
  live.visibility = reinterpret_cast<const float*>(at(3));
  live.object_id = reinterpret_cast<const std::uint32_t*>(at(4));
  live.flags = reinterpret_cast<const std::uint32_t*>(at(5));
  live.cell = reinterpret_cast<const std::uint64_t*>(at(6));
  live.gaussian_id = reinterpret_cast<const std::uint64_t*>(at(7));
  if (need == Need::Both) live.parameters = reinterpret_cast<const float*>(at(8));
  model.average_ = live;
  model.average_.parameters = average;
  if (!model.refresh()) return std::nullopt;
  return model;
}

bool PublishedModel::refresh() {
  if (!copies_) return still_valid();
  const std::size_t source_stride = planes_.back().source.dim(planes_.back().source.shape().size() - 1);
  for (const Plane& plane : planes_) {
    const std::size_t row_bytes = live_.count * plane.element_bytes;
    for (std::size_t channel = 0; channel < plane.channels; ++channel) {
      bus::copy_memory(copies_.get() + plane.copied_at + channel * live_.stride * plane.element_bytes, kind_,
                       plane.source.data() + channel * source_stride * plane.element_bytes, plane.source.memory(),
                       row_bytes);
      if (plane.source.memory() != kind_) copied_bytes_ += row_bytes;
    }
  }
  bus::finish_copies();
  return still_valid();
}

bool PublishedModel::still_valid() const {
  // The first plane tells for all: open() refuses planes that do not share a lock.
  return !planes_.empty() && planes_.front().source.still_valid();
}

}  // namespace splatbus
