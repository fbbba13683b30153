#include "sdk/frame_rings.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <span>

#include "bus/memory.h"
#include "bus/tensor.h"
#include "sdk/validate.h"

namespace splatbus::engine_sdk {
namespace {

constexpr std::size_t kMinSlot = std::size_t{64} << 10;
constexpr std::size_t kRingBytes = std::size_t{256} << 20;
constexpr std::size_t kMinSlots = 8;
constexpr std::size_t kMaxSlots = 128;

}  // namespace

const std::shared_ptr<FrameRing>& FrameRings::ring_for(std::size_t bytes) {
  const std::size_t slot_bytes = std::bit_ceil(std::max(bytes, kMinSlot));
  std::shared_ptr<FrameRing>& ring = rings_[slot_bytes];
  if (!ring) {
    const std::size_t slots = std::clamp(kRingBytes / slot_bytes, kMinSlots, kMaxSlots);
    const std::string role = fmt::format("frames-{}k", slot_bytes >> 10);
    ring = std::make_shared<FrameRing>(
        FrameRing{.role = role, .slab = context_->make_slab(role, slots, slot_bytes, kind_), .refusal = {}});
  }
  return ring;
}

std::vector<std::shared_ptr<FrameRing>> FrameRings::take_unused(std::int64_t now_ns) {
  std::vector<std::shared_ptr<FrameRing>> unused;
  std::erase_if(rings_, [&](const auto& entry) {
    const auto& ring = entry.second;
    if (ring.use_count() > 1 || now_ns - ring->used_ns < kUnusedNs) return false;
    unused.push_back(ring);
    return true;
  });
  return unused;
}

void FrameRings::forget(const FrameRing& ring) {
  std::erase_if(rings_, [&](const auto& entry) { return entry.second.get() == &ring; });
}

std::vector<WrittenFrame> FrameRings::write(std::span<const splatbus_frame> frames, std::int64_t now_ns) {
  std::vector<BegunFrame> begun;
  try {
    for (const splatbus_frame& frame : frames) {
      begun.push_back(begin(frame, now_ns));
      const auto& ring = begun.back().ring;
      if (!ring) continue;
      const auto in_ring = static_cast<std::size_t>(std::ranges::count(begun, ring, &BegunFrame::ring));
      if (in_ring >= ring->slab->slots() / 2) break;
    }
  } catch (...) {
    bus::finish_copies();  // the caller's images are his again
    throw;
  }
  return finish(begun);
}

FrameRings::BegunFrame FrameRings::begin(const splatbus_frame& frame, std::int64_t now_ns) {
  const std::span images(frame.images, frame.image_count);
  if (images.empty()) return {.frame = &frame, .ring = {}, .slot = 0};
  std::size_t total = 0;
  for (const splatbus_image& image : images) total += bus::aligned(image.bytes);
  BegunFrame begun{.frame = &frame, .ring = ring_for(total)};
  begun.ring->used_ns = now_ns;
  bus::Slab& slab = *begun.ring->slab;
  begun.slot = slab.next_slot();
  std::size_t offset = 0;
  for (const splatbus_image& image : images) {
    const Device from = image.memory == SPLATBUS_MEMORY_CUDA ? Device::Cuda : Device::Cpu;
    bus::copy_memory(slab.slot_data(begun.slot) + offset, kind_, image.data, from, image.bytes);
    if (kind_ == Device::Cpu || from == Device::Cpu) host_copied_bytes_ += image.bytes;
    offset += bus::aligned(image.bytes);
  }
  return begun;
}

std::vector<WrittenFrame> FrameRings::finish(const std::vector<BegunFrame>& begun) {
  bus::finish_copies();
  std::vector<WrittenFrame> written;
  for (const BegunFrame& done : begun) {
    if (!done.ring) {
      written.emplace_back();
      continue;
    }
    bus::Slab& slab = *done.ring->slab;
    const std::uint64_t generation = slab.end_write(done.slot);
    WrittenFrame& frame = written.emplace_back(WrittenFrame{done.ring, {}});
    std::size_t offset = 0;
    for (const splatbus_image& image : std::span(done.frame->images, done.frame->image_count)) {
      bus::OutgoingTensor tensor;
      tensor.name = buffer_name(image.buffer);
      tensor.shape = {done.frame->camera.height, done.frame->camera.width};
      if (buffer_channels(image.buffer) > 1)
        tensor.shape.push_back(static_cast<std::uint32_t>(buffer_channels(image.buffer)));
      tensor.type = buffer_type(image.buffer);
      tensor.span = slab.span(done.slot, offset, image.bytes, generation);
      frame.tensors.push_back(std::move(tensor));
      offset += bus::aligned(image.bytes);
    }
  }
  return written;
}

}  // namespace splatbus::engine_sdk
