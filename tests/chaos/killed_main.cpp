// A process that dies at a store into shared memory:
//   test-chaos-killed FOLDER model SLABS CHANGE STORE   a trainer's model, within that change of kill_script.h
//   test-chaos-killed FOLDER ring STORE                 whoever publishes by slots, between begin_write and end_write
// STORE 0 never kills. Says how many stores there were.
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>

#include "../unit/model/kill_script.h"
#include "bus/context.h"
#include "ring_pattern.h"
#include "store_fuse.h"

namespace {

using namespace splatbus;

/// A row of a page is a page of memory, and a change writes hundreds of thousands of values.
constexpr std::size_t kFewOfTheRows = 41;

std::uint64_t change_model(const std::shared_ptr<bus::Context>& context, const std::string& slabs, std::size_t last,
                           std::uint64_t store) {
  model::PageStore pages(context, {}, {.max_gaussians = model::kScriptGaussians}, Device::Cpu);
  model::Truth truth;
  for (std::size_t change = 0; change <= last; ++change) {
    if (change == last) chaos::arm_store_fuse(slabs, store, slabs == "pages-" ? kFewOfTheRows : 1);
    model::make_change(change, &pages, truth);
  }
  return chaos::disarm_store_fuse();
}

std::uint64_t write_ring(const std::shared_ptr<bus::Context>& context, std::uint64_t store) {
  const auto slab = context->create_slab("ring", chaos::kRingSlots, chaos::kRingWords * sizeof(std::uint64_t), 10000,
                                         Device::Cpu, bus::Context::SlabLife::ForSuccessor);
  std::printf("slab %llu\n", static_cast<unsigned long long>(slab->id()));
  std::fflush(stdout);
  chaos::arm_store_fuse("/ring", store);
  for (std::uint64_t value = 1; value <= chaos::kRingWrites; ++value) {
    const std::size_t slot = slab->next_slot();
    auto* words = reinterpret_cast<volatile std::uint64_t*>(slab->slot_data(slot));
    for (std::size_t i = 0; i < chaos::kRingWords; ++i) words[i] = value;
    const std::uint64_t generation = slab->end_write(slot);
    std::printf("wrote %zu %llu %llu\n", slot, static_cast<unsigned long long>(generation),
                static_cast<unsigned long long>(value));
    std::fflush(stdout);
  }
  return chaos::disarm_store_fuse();
}

}  // namespace

int main(int argc, char** argv) {
  const std::string what = argc > 2 ? argv[2] : "";
  if (!(what == "model" && argc == 6) && !(what == "ring" && argc == 4)) return 2;
  const auto context = bus::Context::create(bus::Address::parse("ipc://" + std::string(argv[1])), "trainer");
  const std::uint64_t store = std::strtoull(argv[argc - 1], nullptr, 10);
  const std::uint64_t stores = what == "model"
                                   ? change_model(context, argv[3], std::strtoull(argv[4], nullptr, 10), store)
                                   : write_ring(context, store);
  std::printf("stores %llu\n", static_cast<unsigned long long>(stores));
}
