#include "bus/handover.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cstring>
#include <memory>

#include "bus/error.h"

namespace splatbus::bus {

namespace {

constexpr std::size_t kMostBytes = std::size_t{1} << 30U;
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

bool take_handover(Context& bus, const std::function<void(std::span<const std::byte>)>& take,
                   std::chrono::milliseconds patience) {
  const auto slab = bus.adopt_slab(fmt::format("{}/{}", bus.source(), kRole), static_cast<int>(patience.count()));
  if (!slab) return false;
  struct Drop {
    Context& bus;
    ~Drop() { bus.drop_slab(kRole); }
  } const drop{bus};
  const bool is_one = slab->descriptor().kind == Device::Cpu && slab->slots() == 1;
  if (!is_one || slab->sequence(0) == 0 || slab->sequence(0) % 2 != 0) {
    throw Error("it is not one slot of host memory, written to its end");
  }
  const std::size_t bytes = slab->slot_bytes();
  if (bytes > kMostBytes) throw Error(fmt::format("it has {} MiB", bytes >> 20U));
  // Who left it may still be writing, and what was verified is not to change.
  const auto copy = std::make_unique_for_overwrite<std::byte[]>(bytes);
  std::memcpy(copy.get(), slab->slot_data(0), bytes);
  take({copy.get(), bytes});
  return true;
}

}  // namespace splatbus::bus
