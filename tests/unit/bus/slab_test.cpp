#include <gmock/gmock.h>

#include <array>
#include <cstring>
#include <thread>
#include <utility>
#include <vector>

#include "bus/error.h"
#include "bus/slab_memory.h"
#include "bus_fixture.h"
#include "slab_helpers.h"

namespace splatbus::bus_test {
namespace {

using testing::HasSubstr;
using testing::ThrowsMessage;

class Slabs : public BusTest {};

TEST_F(Slabs, TensorArrivesByReference) {
  const auto context = connect("maker");
  NumberPublisher publisher(context, "viewer/probe");
  const auto slab = context->create_slab("frames", 3, 1000);
  EXPECT_EQ(slab->name(), "maker/frames");
  bus::Subscriber subscriber(connect("reader"), {"viewer/probe"});
  meet(publisher, subscriber);
  publish_number(publisher, 7, false, "", {write_floats(*slab, {1, 2, 3})});
  const auto message = subscriber.receive(patience);
  ASSERT_TRUE(message.has_value());
  const auto view = message->tensor("values", bus::ElementType::F32, {0});
  ASSERT_TRUE(view.has_value());
  EXPECT_EQ(view->as<float>()[2], 3.0F);
  EXPECT_TRUE(view->still_valid());
  const auto forwarded = message->forward_tensor("values");
  ASSERT_TRUE(forwarded.has_value());
  EXPECT_EQ(forwarded->span.slab(), slab->id());
  slab->begin_write(0);
  float copied[3];
  EXPECT_FALSE(view->still_valid());
  EXPECT_FALSE(view->copy(copied));
  EXPECT_FALSE(message->tensor("values").has_value());
  EXPECT_FALSE(message->forward_tensor("values").has_value());
}

TEST_F(Slabs, ReadersCannotWrite) {
  const auto slab = connect("maker")->create_slab("frames", 1, 100);
  const auto reader = connect("reader");
  const auto opened = reader->open_slab(slab->id());
  ASSERT_NE(opened, nullptr);
  EXPECT_FALSE(opened->writable());
  EXPECT_THROW(opened->begin_write(0), bus::Error);
  EXPECT_EQ(opened, reader->open_slab(slab->id()));  // cached
}

TEST_F(Slabs, GenerationsOnlyGrowAndAnOddSlotIsTakenOver) {
  const auto slab = connect("maker")->create_slab("frames", 2, 100);
  EXPECT_EQ(slab->sequence(1), 0u);
  slab->begin_write(1);
  EXPECT_EQ(slab->sequence(1), 1u);
  EXPECT_EQ(slab->end_write(1), 2u);
  slab->begin_write(1);  // the writer dies here, and the next takes over
  slab->begin_write(1);
  EXPECT_EQ(slab->sequence(1) % 2, 1u);
  const std::uint64_t third = slab->end_write(1);
  EXPECT_GT(third, 2u);
  // Two that write beside each other: neither gives out a generation that says it is being written.
  EXPECT_EQ(slab->end_write(1) % 2, 0u);
  EXPECT_GT(slab->sequence(1), third);
  EXPECT_EQ(slab->sequence(0), 0u);
}

TEST_F(Slabs, SpansStayWithinTheirSlot) {
  const auto slab = connect("maker")->create_slab("frames", 2, 100);
  EXPECT_EQ(slab->span(1, 0, 100, 2).offset(), 4096u);
  EXPECT_THROW((void)slab->span(1, 1, 100, 2), bus::Error);
  EXPECT_THROW((void)slab->span(0, 4096, 1, 2), bus::Error);
  EXPECT_THROW((void)slab->span(0, UINT64_MAX, 2, 2), bus::Error);
  using wire::Span;
  using wire::Storage;
  for (const auto& [offset, bytes] : std::initializer_list<std::pair<std::uint64_t, std::uint64_t>>{
           {8192, 1}, {100, 1}, {4096 + 99, 2}, {UINT64_MAX, 1}, {0, UINT64_MAX}, {4095, 2}}) {
    EXPECT_THROW((void)slab->slot_of(Span(slab->id(), 0, offset, bytes, Storage::Slab)), bus::Error) << offset;
  }
}

TEST_F(Slabs, ATensorNeedsWhatItsSpanHas) {
  const auto slab = connect("maker")->create_slab("frames", 1, 100);
  (void)slab->next_slot();
  const auto span = slab->span(0, 0, 100, slab->end_write(0));
  EXPECT_TRUE(bus::TensorView("values", {5, 5}, bus::ElementType::F32, slab, span).still_valid());
  for (const std::uint32_t columns : {4U, 6U, 0xFFFFFFFFU}) {
    EXPECT_THROW(bus::TensorView("values", {5, columns}, bus::ElementType::F32, slab, span), bus::Error) << columns;
  }
}

TEST_F(Slabs, SizesBeyondTheLimitsAreRefused) {
  const auto context = connect("maker");
  EXPECT_THROW((void)context->create_slab("a", 0, 100), bus::Error);
  EXPECT_THROW((void)context->create_slab("a", 1, 0), bus::Error);
  EXPECT_THROW((void)context->create_slab("a", 100000, 1), bus::Error);
  EXPECT_THROW((void)context->create_slab("a", 2, SIZE_MAX), bus::Error);
  EXPECT_THROW((void)context->create_slab("a", 65536, std::size_t{1} << 34), bus::Error);
  EXPECT_THROW((void)context->create_slab(std::string(300, 'a'), 1, 1), bus::Error);  // the name
}

TEST_F(Slabs, AKindWithoutMemoryIsRefused) {
  EXPECT_THAT([&] { (void)connect("maker")->create_slab("frames", 1, 1, 10000, static_cast<Device>(9)); },
              ThrowsMessage<bus::Error>(testing::AllOf(HasSubstr("maker/frames"), HasSubstr("kind 9"))));
}

TEST_F(Slabs, WithoutABrokerCreationSaysSo) {
  const TemporaryDirectory empty;
  const auto context = bus::Context::create(empty.address(), "maker");
  EXPECT_THAT([&] { (void)context->create_slab("frames", 1, 1, 50); },
              ThrowsMessage<bus::Error>(testing::AllOf(HasSubstr("maker/frames"), HasSubstr(empty.path()))));
  EXPECT_EQ(context->open_slab(1), nullptr);
  EXPECT_EQ(context->adopt_slab("maker/frames", 50), nullptr);
}

TEST_F(Slabs, ANameRegisteredAgainReplacesTheOldSlab) {
  const auto context = connect("maker");
  const auto first = context->create_slab("frames", 1, 100);
  const auto second = context->create_slab("frames", 1, 200);
  EXPECT_NE(first->id(), second->id());
  EXPECT_EQ(broker_->statistics().slabs, 1u);
  const auto reader = connect("reader");
  const auto adopted = reader->adopt_slab("maker/frames");
  ASSERT_NE(adopted, nullptr);
  EXPECT_EQ(adopted->id(), second->id());
  EXPECT_EQ(adopted->slot_bytes(), 200u);
  EXPECT_EQ(reader->open_slab(first->id()), nullptr);
  context->drop_slab("frames");
  EXPECT_EQ(broker_->statistics().slabs, 0u);
}

TEST_F(Slabs, AnAdoptedSlabGoesOnWhereItsMakerStopped) {
  std::uint64_t generation = 0;
  {
    const auto slab = connect("maker")->create_slab("model", 1, 100);
    generation = write_floats(*slab, {1, 2}).span.generation();
  }
  const auto context = connect("maker");
  const auto slab = context->adopt_slab("maker/model");
  ASSERT_NE(slab, nullptr);
  EXPECT_TRUE(slab->writable());
  EXPECT_EQ(reinterpret_cast<const float*>(slab->slot_data(0))[1], 2.0F);
  EXPECT_GT(write_floats(*slab, {3, 4}).span.generation(), generation);
}

TEST(SequenceLock, ATornReadIsNeverReportedValid) {
#if defined(__SANITIZE_THREAD__)
  GTEST_SKIP() << "the race is the point";
#endif
  constexpr std::size_t words = 512;
  bus::SlabDescriptor descriptor;
  descriptor.id = 1;
  descriptor.name = "maker/frames";
  descriptor.slots = 1;
  descriptor.slot_bytes = words * sizeof(std::uint64_t);
  const auto slab = bus::create_slab_memory(descriptor, true);
  // Joins when an assertion ends the test early.
  const std::jthread writer([&](const std::stop_token& stop) {
    for (std::uint64_t value = 1; !stop.stop_requested(); ++value) {
      slab->begin_write(0);
      auto* data = reinterpret_cast<volatile std::uint64_t*>(slab->slot_data(0));
      for (std::size_t i = 0; i < words; ++i) data[i] = value;
      slab->end_write(0);
      for (std::uint64_t pause = 0; pause < value % 64 * 64 && !stop.stop_requested();) ++pause;
    }
  });
  std::size_t valid = 0, lost = 0;
  std::vector<std::uint64_t> copy(words);
  while (valid < 200 || lost < 1000) {
    const auto generation = slab->sequence(0);
    const wire::Span span(1, generation, 0, words * sizeof(std::uint64_t), wire::Storage::Slab);
    if (!slab->copy(span, copy.data())) {
      ++lost;
      continue;
    }
    ++valid;
    for (const auto word : copy) ASSERT_EQ(word, copy[0]) << "torn";
    ASSERT_EQ(copy[0] * 2, generation);
  }
}

/// A slab whose writer strikes while it is read.
class StruckSlab final : public bus::Slab {
 public:
  StruckSlab(const bus::SlabDescriptor& descriptor, bus::ControlBlock control)
      : bus::Slab(descriptor, std::move(control), true), bytes_(bus::slab_data_bytes(descriptor)) {
    data_ = bytes_.data();
  }
  [[nodiscard]] int data_fd() const override { return -1; }

  enum class Strike { None, Begins, Overwrites };
  Strike strike = Strike::None;

 protected:
  void read(std::size_t offset, std::size_t bytes, void* destination) const override {
    std::memcpy(destination, data_ + offset, bytes);
    auto& writer = const_cast<StruckSlab&>(*this);
    if (strike != Strike::None) writer.begin_write(0);
    if (strike == Strike::Overwrites) writer.end_write(0);
  }

 private:
  std::vector<std::byte> bytes_;
};

TEST(SequenceLock, ACopyDuringWhichTheSlotWasWrittenIsRefused) {
  bus::SlabDescriptor descriptor;
  descriptor.id = 1;
  descriptor.name = "maker/frames";
  descriptor.slots = 1;
  descriptor.slot_bytes = 64;
  StruckSlab slab(descriptor, bus::ControlBlock::create(descriptor, false));
  std::array<std::byte, 64> copy{};
  for (const auto& [strike, whole] :
       {std::pair(StruckSlab::Strike::None, true), std::pair(StruckSlab::Strike::Begins, false),
        std::pair(StruckSlab::Strike::Overwrites, false)}) {
    slab.begin_write(0);
    const wire::Span span = slab.span(0, 0, 64, slab.end_write(0));
    slab.strike = strike;
    EXPECT_EQ(slab.copy(span, copy.data()), whole);
  }
}

}  // namespace
}  // namespace splatbus::bus_test
