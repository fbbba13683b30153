// Whose doing it is that readers over tcp miss a message.
#include "bus/remote_readers.h"

#include <gmock/gmock.h>

#include <chrono>
#include <future>

#include "bus_fixture.h"
#include "fake_broker.h"

namespace splatbus::bus_service {
namespace {

bus::Frames frames_of(const std::string& topic, const std::string& body) {
  bus::Frames frames;
  frames.topic.rebuild(topic.data(), topic.size());
  frames.body.rebuild(body.data(), body.size());
  return frames;
}

const wire::Header& header_of(const bus::Frames& frames) {
  return *flatbuffers::GetRoot<wire::Envelope>(frames.body.data())->header();
}

TEST(RemoteReaders, OnlyWhatTheyHaveNotReadIsTheirDoing) {
  std::promise<void> go;
  const auto gone = go.get_future().share();
  constexpr std::size_t kMaxBytes = 1 << 20;
  RemoteReaders readers(
      [&](std::uint64_t) {
        gone.wait_for(std::chrono::seconds(30));
        return std::shared_ptr<bus::Slab>();
      },
      kMaxBytes);
  const bus_test::RawTensor tensor{
      .span = wire::Span(1, 2, 0, 4, wire::Storage::Slab), .shape = {1}, .type = wire::ElementType::F32};
  const auto copied = frames_of("slow", bus_test::probe_body(1, 1, {tensor}));
  bool left_out = false;
  while (!left_out) {
    const auto offered = readers.offer(copied, header_of(copied));
    ASSERT_FALSE(offered.now.has_value());
    left_out = offered.left_out;
  }
  EXPECT_THAT(readers.take_unserved(), testing::IsEmpty()) << "copies take long";

  bus::Frames large = frames_of("large", bus_test::probe_body(1, 1));
  large.has_payload = true;
  large.payload.rebuild(kMaxBytes);
  EXPECT_TRUE(readers.offer(large, header_of(large)).left_out);
  EXPECT_THAT(readers.take_unserved(), testing::ElementsAre("large"));
  go.set_value();
}

TEST(RemoteReaders, WhatComesAfterAMessageThatIsStillCopiedWaitsForItAndOtherTopicsDoNot) {
  std::promise<void> go;
  const auto gone = go.get_future().share();
  RemoteReaders readers(
      [&](std::uint64_t) {
        gone.wait_for(std::chrono::seconds(30));
        return std::shared_ptr<bus::Slab>();
      },
      1 << 20);
  const bus_test::RawTensor tensor{
      .span = wire::Span(1, 2, 0, 4, wire::Storage::Slab), .shape = {1}, .type = wire::ElementType::F32};
  const auto offer = [&](const std::string& topic, std::uint64_t number,
                         const std::vector<bus_test::RawTensor>& tensors = {}) {
    const auto frames = frames_of(topic, bus_test::probe_body(number, number, tensors));
    auto offered = readers.offer(frames, header_of(frames));
    EXPECT_FALSE(offered.left_out);
    return offered.now.has_value();
  };
  EXPECT_FALSE(offer("slow", 1, {tensor}));
  EXPECT_FALSE(offer("slow", 2)) << "it has nothing to be copied, but would overtake";
  EXPECT_TRUE(offer("other", 1));
  EXPECT_FALSE(offer("slow", 3));
  go.set_value();
  std::vector<std::uint64_t> came;
  ASSERT_TRUE(bus_test::eventually([&] {
    for (const auto& done : readers.take()) came.push_back(header_of(done.frames).sequence());
    return came.size() == 3;
  }));
  EXPECT_THAT(came, testing::ElementsAre(1, 2, 3));
  EXPECT_TRUE(offer("slow", 4)) << "nothing waits any longer";
}

}  // namespace
}  // namespace splatbus::bus_service
