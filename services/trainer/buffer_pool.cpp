#include "trainer/buffer_pool.h"

#include <algorithm>
#include <bit>
#include <map>
#include <mutex>
#include <utility>

#include "bus/memory.h"

namespace splatbus::trainer {

namespace {

constexpr std::size_t kMinBytes = 4096;
constexpr std::size_t kMaxIdleBytes = std::size_t{256} << 20;

}  // namespace

struct BufferPool::Free {
  std::mutex mutex;
  std::multimap<std::size_t, std::shared_ptr<std::byte>> buffers;  // by size, powers of two
  std::size_t bytes = 0;
};

BufferPool::BufferPool(bus::MemoryKind memory) : memory_(memory), free_(std::make_shared<Free>()) {}

std::shared_ptr<std::byte> BufferPool::take(std::size_t bytes) {
  const std::size_t size = std::bit_ceil(std::max(bytes, kMinBytes));
  std::shared_ptr<std::byte> buffer;
  {
    const std::scoped_lock lock(free_->mutex);
    if (const auto found = free_->buffers.find(size); found != free_->buffers.end()) {
      buffer = std::move(found->second);
      free_->buffers.erase(found);
      free_->bytes -= size;
    }
  }
  if (!buffer) buffer = bus::allocate_memory(memory_, size);
  std::byte* const address = buffer.get();
  return {address, [size, owner = std::move(buffer), free = free_](std::byte* /*address*/) mutable {
            const std::scoped_lock lock(free->mutex);
            if (free->bytes + size > kMaxIdleBytes) return;
            free->bytes += size;
            free->buffers.emplace(size, std::move(owner));
          }};
}

}  // namespace splatbus::trainer
