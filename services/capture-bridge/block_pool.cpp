#include "capture-bridge/block_pool.h"

#include <mutex>
#include <utility>
#include <vector>

#include "bus/memory.h"

namespace splatbus::capture_bridge {

/// Blocks that nobody has, all of one size: the pictures of a rig are, and other sizes are let go of.
struct BlockPool::Idle {
  std::mutex mutex;
  std::size_t bytes = 0;
  std::vector<std::shared_ptr<std::byte>> blocks;

  std::shared_ptr<std::byte> take(std::size_t wanted) {
    std::vector<std::shared_ptr<std::byte>> outgrown;  // freed without the lock
    const std::scoped_lock lock(mutex);
    if (bytes != wanted) {
      bytes = wanted;
      outgrown.swap(blocks);
    }
    if (blocks.empty()) return nullptr;
    auto block = std::move(blocks.back());
    blocks.pop_back();
    return block;
  }

  void give_back(std::shared_ptr<std::byte> block, std::size_t block_bytes) {
    const std::scoped_lock lock(mutex);
    if (block_bytes == bytes) blocks.push_back(std::move(block));
  }
};

BlockPool::BlockPool(bus::MemoryKind kind) : kind_(kind), idle_(std::make_shared<Idle>()) {}

std::shared_ptr<std::byte> BlockPool::take(std::size_t bytes) {
  auto block = idle_->take(bytes);
  if (!block) block = bus::allocate_memory(kind_, bytes);
  std::byte* const address = block.get();
  return {address, [idle = std::weak_ptr(idle_), block = std::move(block), bytes](std::byte*) mutable {
            if (const auto pool = idle.lock()) pool->give_back(std::move(block), bytes);
          }};
}

void BlockPool::reserve(std::size_t count, std::size_t bytes) {
  std::vector<std::shared_ptr<std::byte>> taken;
  for (std::size_t i = 0; i < count; ++i) taken.push_back(take(bytes));
}

}  // namespace splatbus::capture_bridge
