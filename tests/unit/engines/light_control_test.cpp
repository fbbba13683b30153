#include "sim/light_control.h"

#include "sdk_fixture.h"

namespace splatbus::engine_test {
namespace {

using LightControlTest = SdkTest;

TEST_F(LightControlTest, TakesWhatMakesSense) {
  const auto context = connect("tester");
  const bus::Publisher publisher(context);
  sim::LightControl control(directory_.address().text(), "engine");
  const auto send = [&](const std::vector<std::pair<std::string, std::string>>& changes) {
    publisher.publish(topics::control("control/engine-sim"), [&](auto& builder, auto header) {
      std::vector<flatbuffers::Offset<wire::KeyValue>> pairs;
      for (const auto& [key, value] : changes)
        pairs.push_back(wire::CreateKeyValueDirect(builder, key.c_str(), value.c_str()));
      return wire::CreateControlDirect(builder, header, &pairs);
    });
  };
  sim::LightChanges taken;
  ASSERT_TRUE(bus_test::eventually([&] {
    send({{"sun_azimuth_deg", "-12.5"}, {"night", "1"}, {"lamps_shown", "0"}, {"point_lights", "16"}});
    taken = control.take();
    return taken.night.has_value();
  }));
  EXPECT_EQ(taken.sun_azimuth_deg, -12.5);
  EXPECT_EQ(taken.night, true);
  EXPECT_EQ(taken.point_lights, 16U);
  EXPECT_EQ(taken.lamps_shown, false);

  // Of several the last one that makes sense; `last` says that all have arrived.
  send({{"point_lights", "3"},
        {"point_lights", "17"},
        {"point_lights", "-1"},
        {"point_lights", "2.5"},
        {"night", "0"},
        {"night", "2"},
        {"moon", "1"},
        {"lamps_shown", "2"},
        {"sun_azimuth_deg", "nan"},
        {"sun_azimuth_deg", "77"},
        {"sun_azimuth_deg", "9 degrees"}});
  ASSERT_TRUE(bus_test::eventually([&] {
    const sim::LightChanges next = control.take();
    if (next.point_lights != std::size_t{16}) taken = next;
    return taken.sun_azimuth_deg == 77;
  }));
  EXPECT_EQ(taken.point_lights, 3U);
  EXPECT_EQ(taken.night, false);
  EXPECT_FALSE(control.take().night.has_value());
}

}  // namespace
}  // namespace splatbus::engine_test
