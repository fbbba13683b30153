#include "capture-bridge/input_view.h"

#include <cassert>

#include "bus/memory.h"

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
  carve(color);
  carve(albedo);
}

void InputView::copy_pictures(const InputView& from) {
  assert(from.pixels() == pixels());
  bus::copy_memory(block_.get(), memory, from.block_.get(), from.memory, input_view_bytes(pixels()));
  bus::finish_copies();
}

void SampleSet::resize(std::size_t count) {
  for (auto* vectors : {&position, &normal, &albedo, &color}) vectors->resize(count);
  for (auto* scalars : {&footprint_m, &spacing_m, &cosine}) scalars->resize(count);
  for (auto* ids : {&object_id, &camera}) ids->resize(count);
}

}  // namespace splatbus::capture_bridge
