#include "capture-bridge/engine_frame.h"

#include "wire/convert.h"

namespace splatbus::capture_bridge {

namespace {

template <class Pixel>
bool copy_picture(const bus::Message& message, const char* name, bus::ElementType type, const Camera& camera,
                  std::vector<Pixel>& pixels) {
  const auto tensor = message.tensor(name, type, {camera.height, camera.width, 4});
  if (!tensor) return false;
  pixels.resize(static_cast<std::size_t>(camera.width) * camera.height);
  return tensor->copy(pixels.data());
}

}  // namespace

std::optional<InputView> decode_input_frame(const bus::Message& message, const wire::EngineFrame& frame) {
  InputView view;
  view.camera = from_wire(*frame.camera());
  view.frame = frame.frame();
  view.time_s = frame.time_s();
  view.capture_ns = frame.header()->capture_ns();
  view.objects = from_wire(frame.objects());
  view.light = from_wire(*frame.light());
  const bool whole = copy_picture(message, "world_position", bus::ElementType::F32, view.camera, view.position) &&
                     copy_picture(message, "normal", bus::ElementType::F32, view.camera, view.normal) &&
                     copy_picture(message, "color", bus::ElementType::U8, view.camera, view.color) &&
                     copy_picture(message, "albedo", bus::ElementType::U8, view.camera, view.albedo);
  if (!whole) return std::nullopt;
  return view;
}

}  // namespace splatbus::capture_bridge
