#include "expander/insert_batch.h"

#include "device/buffer.h"
#include "gaussians/portable.h"

namespace splatbus::expander {

InsertBatch allocate_batch(device::StreamView stream, std::uint32_t count) {
  const auto memory = std::make_shared<device::Buffer<std::byte>>(stream, count * kInsertBytes);
  return {.count = count, .memory = stream.device, .data = {memory, memory->data()}};
}

std::vector<ObjectFrame> frames_of(const ObjectTransforms& objects) {
  std::vector<ObjectFrame> frames;
  frames.reserve(objects.size());
  for (const auto& [id, world_from_object] : objects) {
    if (id != kWorldFrame) frames.push_back({id, inverse(portable(world_from_object))});
  }
  return frames;
}

}  // namespace splatbus::expander
