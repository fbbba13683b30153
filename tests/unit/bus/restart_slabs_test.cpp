// Latched messages whose payload is in slabs, at a bus that comes back: who hears of them can open them.
#include <gtest/gtest.h>

#include "bus/relay.h"
#include "bus_fixture.h"
#include "slab_helpers.h"

namespace splatbus::bus_test {
namespace {

constexpr auto kLongAway = 2s;  // by then the pauses between tries to find the registry are at their longest

/// A process with a slab, and a message in it that the bus is told again.
struct Maker {
  explicit Maker(std::shared_ptr<bus::Context> context)
      : slab(context->create_slab("model", 1, 1000)), publisher(std::move(context), "grid/state") {}
  void publish(std::uint64_t number) {
    publish_number(publisher, number, true, std::to_string(number), {write_floats(*slab, {1, 2, 3})});
  }

  std::shared_ptr<bus::Slab> slab;
  NumberPublisher publisher;
};

class RestartSlabs : public BusTest {
 protected:
  static constexpr std::uint64_t kMakers = 8;

  /// Of what all makers say; each must be readable when it is heard of.
  static void expect_all_readable(bus::Subscriber& subscriber) {
    for (std::uint64_t k = 0; k < kMakers; ++k) {
      const auto message = subscriber.receive(patience);
      ASSERT_TRUE(message.has_value());
      const auto view = message->tensor("values");
      ASSERT_TRUE(view.has_value()) << "of maker " << number_of(*message);
      EXPECT_EQ(view->as<float>()[2], 3.0F);
    }
  }
};

TEST_F(RestartSlabs, WhoComesAfterwardsCanOpenWhatTheBusWasToldAgain) {
  std::vector<std::unique_ptr<Maker>> makers;
  for (std::uint64_t k = 0; k < kMakers; ++k) {
    makers.push_back(std::make_unique<Maker>(connect("maker-" + std::to_string(k))));
    makers.back()->publish(k);
  }
  broker_->stop();
  std::this_thread::sleep_for(kLongAway);
  broker_->start();
  bus::Subscriber late(connect("late"), {"grid/state"});
  expect_all_readable(late);
}

TEST_F(RestartSlabs, WhoWasThereBeforeCanOpenWhatHasComeSince) {
  std::vector<std::unique_ptr<Maker>> makers;
  std::vector<std::unique_ptr<bus::Subscriber>> readers;
  for (std::uint64_t k = 0; k < kMakers; ++k) {
    makers.push_back(std::make_unique<Maker>(connect("maker-" + std::to_string(k))));
    readers.push_back(std::make_unique<bus::Subscriber>(connect("reader-" + std::to_string(k)),
                                                        std::vector<std::string>{"grid/state"}));
    ASSERT_TRUE(readers.back()->wait_connected(patience));
  }
  broker_->stop();
  std::this_thread::sleep_for(kLongAway);
  for (std::uint64_t k = 0; k < kMakers; ++k) makers[k]->publish(k);
  broker_->start();
  for (const auto& reader : readers) expect_all_readable(*reader);
}

TEST_F(RestartSlabs, ABusWithoutARegistryIsToldAfterASecond) {
  Maker maker(connect("maker"));
  NumberPublisher without(connect("without-slabs"), "grid/state");
  maker.publish(1);
  publish_number(without, 2, true, "2");
  broker_.reset();
  const bus_service::Relay relay(
      options(false), [](std::uint64_t) { return nullptr; }, [] { return std::size_t{0}; });
  bus::Subscriber reader(connect("reader"), {"grid/state"});
  EXPECT_EQ(receive_number(reader), 2U) << "nothing to wait for";
  EXPECT_EQ(receive_number(reader), 1U);
}

}  // namespace
}  // namespace splatbus::bus_test
