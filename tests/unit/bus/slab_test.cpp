#include <cstring>

#include "bus_fixture.h"

namespace splatbus::bus_test {
namespace {

class Slabs : public BusTest {};

bus::OutgoingTensor write_floats(bus::Slab& slab, const std::vector<float>& values) {
  const auto slot = slab.next_slot();
  std::memcpy(slab.slot_data(slot), values.data(), values.size() * sizeof(float));
  const auto generation = slab.end_write(slot);
  bus::OutgoingTensor tensor;
  tensor.name = "values";
  tensor.shape = {static_cast<std::uint32_t>(values.size())};
  tensor.span = slab.span(slot, 0, values.size() * sizeof(float), generation);
  return tensor;
}

TEST_F(Slabs, TensorArrivesByReference) {
  const auto context = connect("maker");
  bus::Publisher publisher(context, "viewer/probe");
  const auto slab = context->create_slab("frames", 3, 1000);
  bus::Subscriber subscriber(connect("reader"), {"viewer/probe"});
  meet(publisher, subscriber);
  publish_number(publisher, 7, false, "", {write_floats(*slab, {1, 2, 3})});
  const auto message = subscriber.receive(patience);
  ASSERT_TRUE(message.has_value());
  const auto view = message->tensor("values", bus::ElementType::F32, {0});
  ASSERT_TRUE(view.has_value());
  EXPECT_EQ(view->as<float>()[2], 3.0F);
  EXPECT_TRUE(view->still_valid());
  slab->begin_write(0);
  EXPECT_FALSE(view->still_valid());
  EXPECT_FALSE(message->tensor("values").has_value());
}

TEST_F(Slabs, TensorArrivesInlineOverTcp) {
  const auto context = connect("maker");
  bus::Publisher publisher(context, "viewer/probe");
  const auto slab = context->create_slab("frames", 3, 1000);
  bus::Subscriber subscriber(connect_tcp("reader"), {"viewer/probe"});
  meet(publisher, subscriber);
  publish_number(publisher, 7, false, "", {write_floats(*slab, {1, 2, 3})});
  const auto message = subscriber.receive(patience);
  ASSERT_TRUE(message.has_value());
  const auto view = message->tensor("values", bus::ElementType::F32, {3});
  ASSERT_TRUE(view.has_value());
  EXPECT_EQ(view->as<float>()[2], 3.0F);
}

}  // namespace
}  // namespace splatbus::bus_test
