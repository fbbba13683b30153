#include "wire/published_model.h"

#include <array>
#include <string>
#include <vector>

#include "bus/error.h"
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

/// The planes of one message. `lost` is set when one of them lies in a slab, or a generation of it, that is gone.
class Planes {
 public:
  Planes(const bus::Message& message, std::uint32_t capacity) : message_(message), capacity_(capacity) {}

  template <class T>
  const T* plane(const char* name, std::uint32_t channels) {
    const auto type = bus::ElementTypeOf<T>::value;
    auto view =
        channels == 0 ? message_.tensor(name, type, {capacity_}) : message_.tensor(name, type, {channels, capacity_});
    if (!view) {
      if (!announces(name)) reject(message_, std::string("plane \"") + name + "\" is missing");
      lost_ = true;
      return nullptr;
    }
    views_->push_back(std::move(*view));
    return views_->back().as<T>().data();
  }

  [[nodiscard]] bool lost() const { return lost_; }
  [[nodiscard]] const std::shared_ptr<std::vector<bus::TensorView>>& views() const { return views_; }

 private:
  [[nodiscard]] bool announces(const std::string& name) const {
    const auto* tensors = message_.header().tensors();
    if (tensors == nullptr) return false;
    for (const auto* tensor : *tensors) {
      if (tensor->name()->str() == name) return true;
    }
    return false;
  }

  const bus::Message& message_;
  std::uint32_t capacity_;
  bool lost_ = false;
  std::shared_ptr<std::vector<bus::TensorView>> views_ = std::make_shared<std::vector<bus::TensorView>>();
};

}  // namespace

std::optional<PublishedModel> PublishedModel::open(const bus::Message& message) {
  const auto& published = message.root<wire::ModelPublished>("ModelPublished/1");
  if (published.capacity() == 0 || published.capacity() > kCapacityLimit) {
    reject(message, "capacity " + std::to_string(published.capacity()) + " is not within 1 and " +
                        std::to_string(kCapacityLimit));
  }
  if (published.count() > published.capacity()) {
    reject(message,
           "count " + std::to_string(published.count()) + " exceeds capacity " + std::to_string(published.capacity()));
  }

  Planes planes(message, static_cast<std::uint32_t>(published.capacity()));
  GaussiansView live;
  live.layout = layout_of(message, published);
  live.count = published.count();
  live.stride = published.capacity();
  const auto channels = static_cast<std::uint32_t>(live.layout.channels());
  live.parameters = planes.plane<float>("parameters", channels);
  const auto* const average = planes.plane<float>("average", channels);
  live.normal = planes.plane<float>("normal", 3);
  live.surface_point = planes.plane<float>("surface_point", 3);
  live.visibility = planes.plane<float>("visibility", 0);
  live.object_id = planes.plane<std::uint32_t>("object_id", 0);
  live.flags = planes.plane<std::uint32_t>("flags", 0);
  live.cell = planes.plane<std::uint64_t>("cell", 0);
  live.gaussian_id = planes.plane<std::uint64_t>("gaussian_id", 0);
  if (planes.lost()) return std::nullopt;

  PublishedModel model;
  model.generation_ = published.generation();
  model.step_ = published.step();
  model.live_ = live;
  model.average_ = live;
  model.average_.parameters = average;
  model.probe_ = planes.views()->front();
  model.keep_alive_ = planes.views();
  if (!model.still_valid()) return std::nullopt;
  return model;
}

bool PublishedModel::still_valid() const {
  return probe_ && probe_->still_valid();
}

}  // namespace splatbus
