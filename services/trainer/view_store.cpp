#include "trainer/view_store.h"

#include <algorithm>
#include <string>

#include "bus/error.h"
#include "wire/capture_generated.h"
#include "wire/convert.h"

namespace splatbus::trainer {

namespace {

constexpr std::uint32_t kMaxSide = 8192;

bool announced(const bus::Message& message, const char* name) {
  const auto* tensors = message.header().tensors();
  return tensors != nullptr && std::any_of(tensors->begin(), tensors->end(),
                                           [&](const wire::Tensor* t) { return t->name()->string_view() == name; });
}

/// Copies a tensor of the camera's size. False when its slot was overwritten.
template <class T>
bool copy_picture(const bus::Message& message, const char* name, std::vector<std::uint32_t> shape,
                  std::vector<T>& out) {
  const auto tensor = message.tensor(name, bus::ElementTypeOf<T>::value, shape);
  if (!tensor) return false;
  out.resize(tensor->elements());
  return tensor->copy(out.data());
}

}  // namespace

ViewStore::ViewStore(std::size_t max_views, std::size_t max_bytes) : max_views_(max_views), max_bytes_(max_bytes) {}

void ViewStore::put(TrainingViewPtr view) {
  const ViewKey key{.role = view->camera.role, .id = view->camera.id};
  const std::scoped_lock lock(mutex_);
  const auto [place, is_new] = views_.try_emplace(key);
  if (is_new) {
    ++cameras_version_;
  } else {
    bytes_ -= place->second.view->bytes();
  }
  bytes_ += view->bytes();
  newest_light_ = view->scene.light.generation;
  place->second = {.view = std::move(view), .updated = ++updates_};
  evict(key);
}

void ViewStore::evict(const ViewKey& newest) {
  while (views_.size() > 1 && (views_.size() > max_views_ || bytes_ > max_bytes_)) {
    auto oldest = views_.end();
    for (auto it = views_.begin(); it != views_.end(); ++it) {
      const bool older = oldest == views_.end() || it->second.updated < oldest->second.updated;
      if (it->first != newest && older) oldest = it;
    }
    bytes_ -= oldest->second.view->bytes();
    views_.erase(oldest);
    ++cameras_version_;
  }
}

void ViewStore::retire(const ViewKey& key) {
  const std::scoped_lock lock(mutex_);
  const auto found = views_.find(key);
  if (found == views_.end()) return;
  bytes_ -= found->second.view->bytes();
  views_.erase(found);
  ++cameras_version_;
}

TrainingViewPtr ViewStore::find(const ViewKey& key) const {
  const std::scoped_lock lock(mutex_);
  const auto found = views_.find(key);
  return found == views_.end() ? nullptr : found->second.view;
}

std::vector<ViewKey> ViewStore::keys(CameraRole role) const {
  const std::scoped_lock lock(mutex_);
  std::vector<ViewKey> keys;
  for (const auto& [key, entry] : views_) {
    if (key.role == role) keys.push_back(key);
  }
  return keys;
}

std::size_t ViewStore::count(CameraRole role) const {
  const std::scoped_lock lock(mutex_);
  return static_cast<std::size_t>(
      std::count_if(views_.begin(), views_.end(), [&](const auto& view) { return view.first.role == role; }));
}

std::optional<std::uint64_t> ViewStore::reference_light() const {
  const std::scoped_lock lock(mutex_);
  const bool ready = std::any_of(views_.begin(), views_.end(), [&](const auto& view) {
    return view.first.role == CameraRole::Reference && view.second.view->scene.light.generation == newest_light_;
  });
  return ready ? std::optional(newest_light_) : std::nullopt;
}

std::size_t ViewStore::bytes() const {
  const std::scoped_lock lock(mutex_);
  return bytes_;
}

std::uint64_t ViewStore::cameras_version() const {
  const std::scoped_lock lock(mutex_);
  return cameras_version_;
}

ViewKey reference_key(const bus::Message& message) {
  const auto& camera = *message.root<wire::CaptureReference>("CaptureReference/1").camera();
  return {.role = static_cast<CameraRole>(camera.role()), .id = camera.id()};
}

ReferenceReading read_reference(const bus::Message& message, bool with_depth) {
  const auto& reference = message.root<wire::CaptureReference>("CaptureReference/1");
  ReferenceReading reading;
  reading.key = reference_key(message);
  if (reading.key.role != CameraRole::Reference && reading.key.role != CameraRole::Input) {
    throw bus::Error(message.topic() + ": a camera of role " + std::to_string(static_cast<int>(reading.key.role)) +
                     " is no training view");
  }
  reading.retire = reference.retire();
  if (reading.retire) return reading;

  TrainingView view;
  view.camera = from_wire(*reference.camera());
  if (view.camera.width > kMaxSide || view.camera.height > kMaxSide) {
    throw bus::Error(message.topic() + ": a picture of " + std::to_string(view.camera.width) + " x " +
                     std::to_string(view.camera.height) + " is larger than " + std::to_string(kMaxSide));
  }
  view.scene = {.light = from_wire(*reference.light()), .objects = from_wire(reference.objects())};
  view.frame = reference.frame();
  const std::uint32_t h = view.camera.height;
  const std::uint32_t w = view.camera.width;
  if (!announced(message, "color"))
    throw bus::Error(message.topic() + " from " + message.header().source()->str() + ": tensor \"color\" is missing");
  bool whole = copy_picture(message, "color", {h, w, 4}, view.color);
  if (whole && announced(message, "albedo")) whole = copy_picture(message, "albedo", {h, w, 4}, view.albedo);
  if (whole && with_depth && announced(message, "depth")) whole = copy_picture(message, "depth", {h, w}, view.depth);
  reading.lost = !whole;
  if (whole) reading.view = std::make_shared<const TrainingView>(std::move(view));
  return reading;
}

}  // namespace splatbus::trainer
