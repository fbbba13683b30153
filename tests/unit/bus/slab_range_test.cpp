#include "bus/slab_range.h"

#include <gmock/gmock.h>

#include <cstring>

#include "bus/error.h"
#include "bus/slab_memory.h"

namespace splatbus::bus {

namespace {

using testing::HasSubstr;

std::shared_ptr<Slab> make_slab(const std::string& name, std::size_t bytes, bool shared = true) {
  static std::uint64_t id = 1;
  return create_slab_memory({.id = id++, .name = name, .slots = 1, .slot_bytes = bytes}, shared);
}

template <class Work>
std::string error_of(const Work& work) {
  try {
    work();
  } catch (const Error& error) {
    return error.what();
  }
  return "no error";
}

TEST(SlabRange, SlabsLieOneBehindTheOtherAndNothingMovesAsItGrows) {
  SlabRange range(Device::Cpu, std::size_t{1} << 20U);
  std::byte* const start = range.data();
  const auto first = make_slab("trainer/pages-0", 8192);
  const auto second = make_slab("trainer/pages-1", 4096, false);  // private ones too
  range.append(first);
  std::memset(start, 1, 8192);
  range.append(second);
  std::memset(start + 8192, 2, 4096);
  EXPECT_EQ(range.data(), start);
  EXPECT_EQ(range.bytes(), 12288U);
  // One memory under two addresses.
  EXPECT_EQ(std::to_integer<int>(first->slot_data(0)[8191]), 1);
  EXPECT_EQ(std::to_integer<int>(second->slot_data(0)[0]), 2);
  second->slot_data(0)[4095] = std::byte{7};
  EXPECT_EQ(std::to_integer<int>(start[12287]), 7);
}

TEST(SlabRange, RefusesWhatDoesNotFitAndKeepsWhatItHas) {
  SlabRange range(Device::Cpu, 8192);
  range.append(make_slab("a/pages-0", 4096));
  EXPECT_THAT(error_of([&] { range.append(make_slab("a/pages-1", 8192)); }), HasSubstr("8192 bytes are reserved"));
  EXPECT_EQ(range.bytes(), 4096U);
  range.append(make_slab("a/pages-2", 4096));
  EXPECT_EQ(range.bytes(), 8192U);
  EXPECT_EQ(range.slabs().size(), 2U);
}

TEST(SlabRange, ThatOnlyReadsCannotWrite) {
  const auto owner = make_slab("b/pages-0", 4096);
  owner->slot_data(0)[5] = std::byte{9};
  const auto reader = map_slab_memory(owner->descriptor(), FileDescriptor(::dup(owner->control_fd())),
                                      FileDescriptor(::dup(owner->data_fd())), false);
  SlabRange range(Device::Cpu, 4096);
  range.append(reader);
  EXPECT_EQ(std::to_integer<int>(range.data()[5]), 9);
  EXPECT_DEATH(range.data()[5] = std::byte{1}, "");
}

}  // namespace

}  // namespace splatbus::bus
