#pragma once

#include <gtest/gtest.h>

#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "../../bus/bus_fixture.h"
#include "capture-bridge/capture_bridge.h"
#include "capture-bridge/parameters.h"
#include "fake_engine.h"
#include "wire/capture_generated.h"
#include "wire/viewer_generated.h"

namespace splatbus::capture_bridge::test {

using namespace std::chrono_literals;

/// A bridge between an engine and readers made by hand, all in this thread but the bridge's sampling.
class CaptureBridgeTest : public bus_test::BusTest {
 protected:
  CaptureBridgeTest()
      : parameters_(bus::Parameters::declare<Options>()),
        peer_(connect("peer")),
        reader_(peer_, {"capture/*", "scene/*"}),
        running_engine_(std::make_unique<FakeEngine>(connect("engine"))),
        engine_(*running_engine_),
        publisher_(peer_) {
    set("input_cameras", "4");
    set("input_size", "32");
    set("reference_cameras", "2");
    set("reference_size", "16");
    set("reference_rate_hz", "0");
    set("light_depth_size", "16");
    set("input_deadline_s", "0.2");
  }

  void set(const std::string& name, const std::string& value) { ASSERT_EQ(parameters_.set(name, value, true), ""); }

  void start() {
    bridge_ = std::make_unique<CaptureBridge>(connect("capture-bridge"), parameters_);
    // What the bridge says once is not to be missed.
    ASSERT_TRUE(reader_.wait_connected(bus_test::patience));
  }

  /// Runs bridge and engine and reads what comes out, until the condition holds.
  bool until(const std::function<bool()>& condition, std::chrono::milliseconds timeout = bus_test::patience) {
    return bus_test::eventually(
        [&] {
          bridge_->step(1ms);
          if (running_engine_) running_engine_->serve();
          while (auto message = reader_.receive(0ms)) received_[message->topic()].push_back(*message);
          return condition();
        },
        timeout);
  }

  void settle() {
    start();
    const bool settled = until([&] {
      return !received_["capture/input"].empty() && references(CameraRole::Reference).size() == 2 &&
             references(CameraRole::Input).size() == 4 && !received_["scene/light_depth"].empty();
    });
    if (!settled) throw std::runtime_error("the bridge has not settled");  // a test reads what came
  }

  std::vector<const wire::CaptureReference*> references(CameraRole role) {
    std::vector<const wire::CaptureReference*> found;
    for (const bus::Message& message : received_["capture/reference"]) {
      const auto& reference = message.root<wire::CaptureReference>();
      if (reference.camera()->role() == static_cast<wire::CameraRole>(role)) found.push_back(&reference);
    }
    return found;
  }

  const wire::CaptureInput& last_input() { return received_["capture/input"].back().root<wire::CaptureInput>(); }

  void look_from(const Camera& camera) {
    publisher_.publish(topics::kViewerPose, [&](auto& builder, auto header) {
      const wire::Camera out = to_wire(camera);
      return wire::CreateViewerPose(builder, header, builder.CreateString("viewer-1"), &out);
    });
  }

  void ask_probe(std::uint64_t id, const Camera& camera) {
    publisher_.publish(topics::kViewerProbe, [&](auto& builder, auto header) {
      const wire::Camera out = to_wire(camera);
      return wire::CreateViewerProbe(builder, header, id, &out);
    });
  }

  bus::Parameters parameters_;
  std::shared_ptr<bus::Context> peer_;
  bus::Subscriber reader_;
  std::unique_ptr<FakeEngine> running_engine_;  ///< null once a test has ended it
  FakeEngine& engine_;
  bus::Publisher publisher_;
  std::map<std::string, std::vector<bus::Message>> received_;
  std::unique_ptr<CaptureBridge> bridge_;
};

}  // namespace splatbus::capture_bridge::test
