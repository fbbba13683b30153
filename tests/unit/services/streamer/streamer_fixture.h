#pragma once

#include <gtest/gtest.h>

#include <functional>
#include <memory>
#include <random>

#include "stream_fixture.h"
#include "streamer/streamer.h"

namespace splatbus::stream_test {

using namespace std::chrono_literals;
using viewer::StreamClient;

class StreamerTest : public StreamTest {
 protected:
  StreamerTest() : observer_(connect("observer")) {}

  /// The first message on a topic that the condition accepts.
  template <class T>
  static bool wait_message(bus::Subscriber& subscriber, const char* schema, const std::function<bool(const T&)>& accept,
                           const std::function<void()>& meanwhile = {}) {
    const auto deadline = std::chrono::steady_clock::now() + bus_test::patience;
    while (std::chrono::steady_clock::now() < deadline) {
      if (meanwhile) meanwhile();
      while (const auto message = subscriber.receive(1ms)) {
        if (accept(message->root<T>(schema))) return true;
      }
    }
    return false;
  }

  static void grow(GaussiansBuffer& model, std::size_t count, std::uint32_t seed) {
    const GaussiansBuffer more = stream::test::toy_model(model.count() + count, seed);
    const std::size_t before = model.count();
    GaussiansBuffer grown = more;
    for (int c = 0; c < model.layout().channels(); ++c) {
      for (std::size_t i = 0; i < before; ++i) {
        grown.parameters[static_cast<std::size_t>(c) * grown.stride() + i] =
            model.parameters[static_cast<std::size_t>(c) * model.stride() + i];
      }
    }
    model = grown;
  }

  static void disturb(GaussiansBuffer& model, std::mt19937& random) {
    std::normal_distribution<float> normal(0, 0.1F);
    for (float& value : model.parameters) value += normal(random);
  }

  std::shared_ptr<bus::Context> observer_;
};

}  // namespace splatbus::stream_test
