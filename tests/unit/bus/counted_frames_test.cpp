#include "bus/counted_frames.h"

#include <gtest/gtest.h>

#include <cstring>
#include <string>

namespace splatbus::bus_service {
namespace {

zmq::message_t filled(std::size_t bytes, char with) {
  zmq::message_t frame(bytes);
  std::memset(frame.data(), with, bytes);
  return frame;
}

TEST(UnsentBytes, AreThoseOfFramesThatAreStillThere) {
  const UnsentBytes unsent(1 << 20);
  {
    zmq::message_t made = unsent.make(10000), small = unsent.make(4095);
    EXPECT_EQ(unsent.bytes(), 10000U) << "what is small is not counted";
    zmq::message_t second;
    second.copy(made);
    EXPECT_EQ(unsent.bytes(), 10000U) << "two readers of one frame hold it once";
    made.rebuild();
    EXPECT_EQ(unsent.bytes(), 10000U);
    second.rebuild();
    EXPECT_EQ(unsent.bytes(), 0U);
  }
  zmq::message_t original = filled(8000, 'a');
  zmq::message_t shared = unsent.share(original), copied = unsent.copy(original);
  EXPECT_EQ(unsent.bytes(), 16000U);
  EXPECT_EQ(shared.data(), original.data());
  EXPECT_NE(copied.data(), original.data());
  original.rebuild();
  EXPECT_EQ(shared.to_string(), std::string(8000, 'a'));
  EXPECT_EQ(copied.to_string(), std::string(8000, 'a'));
  copied.rebuild();
  EXPECT_EQ(unsent.bytes(), 8000U);
}

TEST(UnsentBytes, MayOutliveTheirCount) {
  zmq::message_t frame;
  {
    const UnsentBytes unsent(1 << 20);
    frame = unsent.make(10000);
  }
  std::memset(frame.data(), 1, frame.size());
}

TEST(UnsentBytes, LargeOnesLeaveRoomForSmallOnes) {
  const UnsentBytes unsent(1 << 20);
  EXPECT_TRUE(unsent.has_room(std::size_t{5} << 20)) << "where there is nothing else, one of any size";
  EXPECT_FALSE(unsent.has_room(std::size_t{5} << 20, 1));
  const zmq::message_t held = unsent.make((1 << 20) - 100000);
  EXPECT_TRUE(unsent.has_room(100000));
  EXPECT_FALSE(unsent.has_room(100001));
  EXPECT_FALSE(unsent.has_room(100000, 1));
  const zmq::message_t all = unsent.make(100000);
  EXPECT_TRUE(unsent.has_room(65536));
  EXPECT_FALSE(unsent.has_room(65537));
  EXPECT_FALSE(unsent.has_room(65536, (1 << 18) - 65535));
  EXPECT_TRUE(unsent.has_room(4095, std::size_t{1} << 30));
}

}  // namespace
}  // namespace splatbus::bus_service
