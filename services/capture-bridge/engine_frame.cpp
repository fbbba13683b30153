#include "capture-bridge/engine_frame.h"

#include "bus/memory.h"
#include "wire/convert.h"

namespace splatbus::capture_bridge {

std::optional<InputView> decode_input_frame(const bus::Message& message, const wire::EngineFrame& frame,
                                            bus::MemoryPool& pool, std::atomic<std::uint64_t>& host_bytes) {
  InputView view;
  view.camera = from_wire(*frame.camera());
  view.frame = frame.scene()->frame();
  view.time_s = frame.scene()->time_s();
  view.capture_ns = frame.header()->capture_ns();
  view.objects = from_wire(frame.scene()->objects());
  view.light = from_wire(*frame.scene()->light());
  const auto picture = [&](const char* name, bus::ElementType type) {
    return message.tensor(name, type, {view.camera.height, view.camera.width, 4});
  };
  const auto position = picture("world_position", bus::ElementType::F32);
  const auto normal = picture("normal", bus::ElementType::F32);
  const auto color = picture("color", bus::ElementType::U8);
  const auto albedo = picture("albedo", bus::ElementType::U8);
  if (!position || !normal || !color || !albedo) return std::nullopt;
  // Only now: that the tensors are there bounds the size.
  view.allocate(pool);
  const bool whole = bus::copy_tensor(*position, view.position.data(), view.memory, host_bytes) &&
                     bus::copy_tensor(*normal, view.normal.data(), view.memory, host_bytes) &&
                     bus::copy_tensor(*color, view.color.data(), view.memory, host_bytes) &&
                     bus::copy_tensor(*albedo, view.albedo.data(), view.memory, host_bytes);
  if (!whole) return std::nullopt;
  return view;
}

}  // namespace splatbus::capture_bridge
