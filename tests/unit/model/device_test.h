#pragma once

#include <gmock/gmock.h>

#include <stdexcept>
#include <string>

#include "../bus/bus_fixture.h"
#include "truth.h"

namespace splatbus::model {

/// On a bus of its own, once a device; skipped where there is none.
class DeviceTest : public bus_test::BusTest, public testing::WithParamInterface<Device> {
 protected:
  void SetUp() override {
    if (GetParam() == Device::Cpu) return;
    try {
      static_cast<void>(device::Stream(Device::Cuda));
    } catch (const std::runtime_error& error) {
      GTEST_SKIP() << error.what();
    }
  }

  /// Each Gaussian that should be there is there with all of its values, and no other.
  static void expect_whole(const Found& found, const Truth& truth) {
    ASSERT_EQ(found.by_id.size(), truth.gaussians.size());
    for (const auto& [id, gaussian] : truth.gaussians) {
      const auto place = found.by_id.find(id);
      ASSERT_NE(place, found.by_id.end()) << "Gaussian " << id << " is lost";
      ASSERT_EQ(place->second.gaussian, gaussian) << "Gaussian " << id;
    }
  }
};

inline std::string device_name(const testing::TestParamInfo<Device>& info) {
  return std::string(name_of(info.param));
}

}  // namespace splatbus::model
