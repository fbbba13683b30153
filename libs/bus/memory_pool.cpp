#include "bus/memory_pool.h"

#include <algorithm>
#include <bit>
#include <iterator>
#include <list>
#include <mutex>
#include <utility>
#include <vector>

#include "bus/memory.h"

namespace splatbus::bus {

namespace {

constexpr std::size_t kLeastBytes = 4096;

/// Sizes that differ little share their memory: an eighth is wasted at most.
std::size_t rounded(std::size_t bytes) {
  const std::size_t eighth = std::bit_floor(std::max(bytes, kLeastBytes)) / 8;
  return (std::max(bytes, kLeastBytes) + eighth - 1) / eighth * eighth;
}

}  // namespace

/// What nobody has.
class MemoryPool::Idle {
 public:
  explicit Idle(std::size_t bound) : bound_(bound) {}

  std::shared_ptr<std::byte> take(std::size_t size) {
    const std::scoped_lock lock(mutex_);
    const auto found = std::find_if(blocks_.rbegin(), blocks_.rend(), [&](const Block& b) { return b.size == size; });
    if (found == blocks_.rend()) return nullptr;
    auto memory = std::move(found->memory);
    blocks_.erase(std::next(found).base());
    bytes_ -= size;
    return memory;
  }

  void give_back(std::shared_ptr<std::byte> memory, std::size_t size) {
    std::list<Block> freed;  // without the lock
    const std::scoped_lock lock(mutex_);
    if (size > bound_) return;  // it would push out all others before it went itself
    blocks_.push_back({.size = size, .memory = std::move(memory)});
    bytes_ += size;
    while (bytes_ > bound_) {
      bytes_ -= blocks_.front().size;
      freed.splice(freed.end(), blocks_, blocks_.begin());
    }
  }

  [[nodiscard]] std::size_t bytes() {
    const std::scoped_lock lock(mutex_);
    return bytes_;
  }

  void keep_at_least(std::size_t bytes) {
    const std::scoped_lock lock(mutex_);
    bound_ = std::max(bound_, bytes);
  }

 private:
  struct Block {
    std::size_t size = 0;
    std::shared_ptr<std::byte> memory;
  };
  std::mutex mutex_;
  std::list<Block> blocks_;  // in the order in which they came back
  std::size_t bytes_ = 0, bound_;
};

MemoryPool::MemoryPool(Device kind, std::size_t idle_bytes) : kind_(kind), idle_(std::make_shared<Idle>(idle_bytes)) {}

std::size_t MemoryPool::idle_bytes() const {
  return idle_->bytes();
}

std::shared_ptr<std::byte> MemoryPool::take(std::size_t bytes) {
  const std::size_t size = rounded(bytes);
  auto memory = idle_->take(size);
  if (!memory) memory = allocate_memory(kind_, size);
  std::byte* const address = memory.get();
  return {address, [pool = std::weak_ptr(idle_), memory = std::move(memory), size](std::byte* /*address*/) mutable {
            if (const auto idle = pool.lock()) idle->give_back(std::move(memory), size);
          }};
}

void MemoryPool::reserve(std::size_t count, std::size_t bytes) {
  idle_->keep_at_least(count * rounded(bytes));
  std::vector<std::shared_ptr<std::byte>> taken;
  taken.reserve(count);
  for (std::size_t i = 0; i < count; ++i) taken.push_back(take(bytes));
}

}  // namespace splatbus::bus
