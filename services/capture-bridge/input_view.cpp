#include "capture-bridge/input_view.h"

#include <algorithm>
#include <array>
#include <cassert>

#include "bus/memory.h"
#include "wire/convert.h"

namespace splatbus::capture_bridge {

void InputView::allocate(bus::MemoryPool& pool) {
  const std::size_t count = pixels();
  memory = pool.kind();
  block_ = pool.take(input_view_bytes(count));
  std::byte* next = block_.get();
  const auto carve = [&]<class Pixel>(std::span<Pixel>& picture) {
    picture = {reinterpret_cast<Pixel*>(next), count};
    next += picture.size_bytes();
  };
  carve(position);
  carve(normal);
  carve(object_id);
  carve(color);
  carve(albedo);
}

bool InputView::take_pictures(const bus::TensorView& from, std::atomic<std::uint64_t>& host_bytes) {
  assert(from.bytes() == input_view_bytes(pixels()));
  return bus::copy_tensor(from, block_.get(), memory, host_bytes);
}

void InputView::copy_pictures(const InputView& from) {
  assert(from.pixels() == pixels());
  bus::copy_memory(block_.get(), memory, from.block_.get(), from.memory, input_view_bytes(pixels()));
  bus::finish_copies();
}

std::optional<InputView> decode_input_frame(const bus::Message& message, const wire::EngineFrame& frame,
                                            bus::MemoryPool& pool, std::atomic<std::uint64_t>& host_bytes) {
  InputView view;
  view.camera = from_wire(*frame.camera());
  view.frame = frame.scene()->frame();
  view.time_s = frame.scene()->time_s();
  view.capture_ns = frame.header()->capture_ns();
  view.objects = from_wire(frame.scene()->objects());
  view.light = from_wire(*frame.scene()->light());
  const std::uint32_t width = view.camera.width, height = view.camera.height;
  const std::array<std::optional<bus::TensorView>, 5> pictures{
      message.tensor("world_position", bus::ElementType::F32, {height, width, 4}),
      message.tensor("normal", bus::ElementType::F32, {height, width, 4}),
      message.tensor("object_id", bus::ElementType::U32, {height, width}),
      message.tensor("color", bus::ElementType::U8, {height, width, 4}),
      message.tensor("albedo", bus::ElementType::U8, {height, width, 4})};
  const auto usable = [&] {
    return std::ranges::all_of(pictures, [](const auto& picture) { return picture && picture->still_valid(); });
  };
  if (!usable()) return std::nullopt;
  // Only now: that the tensors are there bounds the size.
  view.allocate(pool);
  const std::array<void*, 5> destinations{view.position.data(), view.normal.data(), view.object_id.data(),
                                          view.color.data(), view.albedo.data()};
  for (std::size_t k = 0; k < pictures.size(); ++k) {
    const bus::TensorView& picture = *pictures.at(k);
    bus::copy_memory(destinations.at(k), view.memory, picture.data(), picture.memory(), picture.bytes());
    if (view.memory == Device::Cpu || picture.memory() == Device::Cpu) host_bytes += picture.bytes();
  }
  bus::finish_copies();
  if (!usable()) return std::nullopt;
  return view;
}

}  // namespace splatbus::capture_bridge
