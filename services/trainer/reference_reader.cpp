#include "trainer/reference_reader.h"

#include <memory>
#include <utility>

#include "bus/error.h"
#include "bus/memory.h"
#include "device/buffer.h"
#include "gaussians/portable.h"
#include "trainer/farthest_surfaces.h"
#include "trainer/memory_failure.h"
#include "trainer/object_mask.h"
#include "trainer/sky_albedo.h"
#include "wire/capture_generated.h"
#include "wire/convert.h"

namespace splatbus::trainer {

namespace {

constexpr std::size_t kMaxDeviceObjects =
    32768 + 1;  // SPLATBUS_MAX_OBJECTS and the far field; a batch has room for two views' of that many

}  // namespace

ReferenceReader::ReferenceReader(Device memory, std::size_t max_pixels, std::size_t max_bytes,
                                 std::atomic<std::uint64_t>& host_bytes)
    : memory_(memory), max_pixels_(max_pixels), max_bytes_(max_bytes), host_bytes_(host_bytes), pool_(memory) {}

/// Copies a tensor of the camera's size. False when its slot was overwritten.
template <class T>
bool ReferenceReader::read_picture(const bus::Message& message, const char* name, std::vector<std::uint32_t> shape,
                                   Pixels<T>& out) {
  const auto tensor = message.tensor(name, bus::ElementTypeOf<T>::value, std::move(shape));
  if (!tensor) return false;
  return in_own_memory([&] {
    const auto buffer = pool_.take(tensor->bytes());
    if (!bus::copy_tensor(*tensor, buffer.get(), memory_, host_bytes_)) return false;
    out = Pixels<T>(std::shared_ptr<const T>(buffer, reinterpret_cast<const T*>(buffer.get())), tensor->elements());
    return true;
  });
}

bool ReferenceReader::read_albedo(const bus::Message& message, TrainingView& view) {
  const auto& camera = view.camera;
  if (!view.scene.objects.contains(kFarFieldFrame)) {
    return read_picture(message, "albedo", {camera.height, camera.width, 4}, view.albedo);
  }
  const auto tensor = message.tensor("albedo", bus::ElementType::U8, {camera.height, camera.width, 4});
  if (!tensor) return false;
  return in_own_memory([&] {
    const auto buffer = pool_.take(tensor->bytes());
    if (!bus::copy_tensor(*tensor, buffer.get(), memory_, host_bytes_)) return false;
    auto* const albedo = reinterpret_cast<std::uint8_t*>(buffer.get());
    add_sky_albedo(device::thread_stream(memory_), view.color.data(), camera.width * camera.height,
                   portable(view.scene.light.background), albedo);
    view.albedo = Pixels<std::uint8_t>({buffer, albedo}, tensor->elements());
    return true;
  });
}

bool ReferenceReader::read_depth(const bus::Message& message, TrainingView& view) {
  const std::uint32_t width = view.camera.width, height = view.camera.height;
  if (!read_picture(message, "depth", {height, width}, view.depth)) return false;
  in_own_memory([&] {
    const std::size_t squares = surface_squares(width, height);
    const auto buffer = pool_.take(squares * sizeof(float));
    auto* const farthest_m = reinterpret_cast<float*>(buffer.get());
    const device::StreamView stream = device::thread_stream(memory_);
    find_farthest_surfaces(stream, view.depth.data(), width, height, farthest_m);
    stream.wait();
    view.farthest_m = Pixels<float>({buffer, farthest_m}, squares);
  });
  return true;
}

bool ReferenceReader::read_mask(const bus::Message& message, TrainingView& view) {
  std::vector<std::uint32_t> ids;
  for (const auto& [id, object] : view.scene.objects) {
    if (!object.modelled) ids.push_back(id);
  }
  if (ids.empty()) return true;
  if (!message.announces("object_id")) {
    throw bus::Error(
        message.topic() + " from " + message.header().source()->str() +
        ": objects are not to be modelled, and tensor \"object_id\" is missing, which says where they show");
  }
  Pixels<std::uint32_t> object_id;
  if (!read_picture(message, "object_id", {view.camera.height, view.camera.width}, object_id)) return false;
  in_own_memory([&] {
    const auto buffer = pool_.take(object_id.size());
    auto* const mask = reinterpret_cast<std::uint8_t*>(buffer.get());
    const device::StreamView stream = device::thread_stream(memory_);
    device::Buffer<std::uint32_t> unmodelled(stream);
    unmodelled.assign(ids);
    mask_objects(stream, object_id.data(), static_cast<std::uint32_t>(object_id.size()), unmodelled.data(),
                 static_cast<std::uint32_t>(ids.size()), mask);
    stream.wait();
    view.mask = Pixels<std::uint8_t>({buffer, mask}, object_id.size());
  });
  return true;
}

ViewKey reference_key(const bus::Message& message) {
  const auto& camera = *message.root<wire::CaptureReference>().camera();
  return {.role = static_cast<CameraRole>(camera.role()), .id = camera.id()};
}

ReferenceReading ReferenceReader::read(const bus::Message& message, bool with_depth) {
  const auto& reference = message.root<wire::CaptureReference>();
  ReferenceReading reading;
  reading.key = reference_key(message);
  if (reading.key.role != CameraRole::Reference && reading.key.role != CameraRole::Input) {
    throw bus::Error(message.topic() + ": a camera of role " + std::to_string(static_cast<int>(reading.key.role)) +
                     " is not a training view");
  }
  reading.retire = reference.retire();
  if (reading.retire) return reading;

  TrainingView view;
  view.camera = from_wire(*reference.camera());
  if (std::size_t{view.camera.width} * view.camera.height > max_pixels_) {
    throw bus::Error(message.topic() + ": a picture of " + std::to_string(view.camera.width) + " x " +
                     std::to_string(view.camera.height) + " has more pixels than max_picture_mpixels allows");
  }
  view.scene = from_wire(*reference.scene());
  if (memory_ == Device::Cuda && view.scene.objects.size() > kMaxDeviceObjects) {
    throw bus::Error(message.topic() + ": " + std::to_string(view.scene.objects.size()) +
                     " moving objects are more than the CUDA backend takes (" + std::to_string(kMaxDeviceObjects) +
                     ")");
  }
  view.frame = reference.scene()->frame();
  view.memory = memory_;
  const std::uint32_t h = view.camera.height;
  const std::uint32_t w = view.camera.width;
  if (!message.announces("color"))
    throw bus::Error(message.topic() + " from " + message.header().source()->str() + ": tensor \"color\" is missing");
  const bool with_albedo = message.announces("albedo");
  with_depth = with_depth && message.announces("depth");
  const std::size_t bytes = std::size_t{h} * w * (4 + (with_albedo ? 4 : 0) + (with_depth ? sizeof(float) : 0));
  if (bytes > max_bytes_) {
    throw bus::Error(message.topic() + ": pictures of " + std::to_string(w) + " x " + std::to_string(h) + " take " +
                     std::to_string(bytes >> 20) + " MiB, and all of them have " + std::to_string(max_bytes_ >> 20) +
                     " MiB");
  }
  bool whole = read_picture(message, "color", {h, w, 4}, view.color);
  if (whole && with_albedo) whole = read_albedo(message, view);
  if (whole && with_depth) whole = read_depth(message, view);
  whole = whole && read_mask(message, view);
  reading.lost = !whole;
  if (whole) reading.view = std::make_shared<const TrainingView>(std::move(view));
  return reading;
}

}  // namespace splatbus::trainer
