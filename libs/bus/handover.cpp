#include "bus/handover.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cstring>
#include <memory>

#include "bus/error.h"

namespace splatbus::bus {

namespace {

constexpr const char* kRole = "handover";
constexpr std::chrono::milliseconds kAnswerPatience{500};  // whoever ends a service may kill it after 3 s

}  // namespace

bool leave_handover(Context& bus, std::size_t bytes, const std::function<void(std::byte* memory)>& fill,
                    std::chrono::milliseconds patience) {
  if (!bus.address().is_local() || !bus.wait_connected(patience)) return false;
  const auto answer_ms = static_cast<int>(std::max(patience, kAnswerPatience).count());
  const auto slab = bus.create_slab(kRole, 1, bytes, answer_ms, Device::Cpu, Context::SlabLife::ForSuccessor);
  slab->begin_write(0);
  fill(slab->slot_data(0));
  slab->end_write(0);
  return true;
}

bool take_handover(Context& bus, const std::function<void(std::span<const std::byte>)>& take, std::size_t most_bytes,
                   std::chrono::milliseconds patience) {
  auto slab = bus.adopt_slab(fmt::format("{}/{}", bus.source(), kRole), static_cast<int>(patience.count()));
  if (!slab) return false;
  // What was verified is not to change, and what ends its reader is not to end the next one too: it is copied, and gone
  // before it is read.
  const bool is_one = slab->descriptor().kind == Device::Cpu && slab->slots() == 1;
  const bool is_whole = is_one && slab->sequence(0) != 0 && slab->sequence(0) % 2 == 0;
  const std::size_t bytes = slab->slot_bytes();
  std::unique_ptr<std::byte[]> copy;
  if (is_whole && bytes <= most_bytes) {
    copy = std::make_unique_for_overwrite<std::byte[]>(bytes);
    std::memcpy(copy.get(), slab->slot_data(0), bytes);
  }
  slab.reset();
  bus.drop_slab(kRole);
  if (!is_whole) throw Error("it is not one slot of host memory, written to its end");
  if (!copy) throw Error(fmt::format("it has {} MiB", bytes >> 20U));
  take({copy.get(), bytes});
  return true;
}

}  // namespace splatbus::bus
