#pragma once

#include <gtest/gtest.h>
#include <stdlib.h>

#include <chrono>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <thread>

#include "bus/broker.h"
#include "bus/context.h"
#include "bus/publisher.h"
#include "bus/subscriber.h"
#include "wire/viewer_generated.h"

namespace splatbus::bus_test {

using namespace std::chrono_literals;

/// How long a condition that must come true may take, on a loaded machine.
constexpr auto patience = 60s;

/// A folder of its own, removed at the end.
class TemporaryDirectory {
 public:
  TemporaryDirectory() {
    std::string name = (std::filesystem::temp_directory_path() / "splatbus-test-XXXXXX").string();
    if (::mkdtemp(name.data()) == nullptr) throw std::runtime_error("mkdtemp");
    path_ = name;
  }
  ~TemporaryDirectory() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  TemporaryDirectory(const TemporaryDirectory&) = delete;
  TemporaryDirectory& operator=(const TemporaryDirectory&) = delete;

  [[nodiscard]] const std::string& path() const { return path_; }
  [[nodiscard]] bus::Address address() const { return bus::Address::parse("ipc://" + path_); }

 private:
  std::string path_;
};

/// Polls a condition; false when it did not come true in time.
inline bool eventually(const std::function<bool()>& condition, std::chrono::milliseconds timeout = patience) {
  const auto deadline = std::chrono::steady_clock::now() + timeout;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > deadline) return false;
    std::this_thread::sleep_for(2ms);
  }
  return true;
}

/// A broker on a temporary folder.
class BusTest : public testing::Test {
 protected:
  BusTest() : broker_(std::make_unique<bus_service::Broker>(options())) { broker_->start(); }

  [[nodiscard]] bus_service::BrokerOptions options(bool tcp = true) const {
    bus_service::BrokerOptions result;
    result.address = directory_.address();
    if (tcp) result.tcp_host = "127.0.0.1";
    return result;
  }

  std::shared_ptr<bus::Context> connect(const std::string& source) {
    return bus::Context::create(directory_.address(), source);
  }
  std::shared_ptr<bus::Context> connect_tcp(const std::string& source) {
    return bus::Context::create(broker_->tcp_address().value(), source);
  }

  TemporaryDirectory directory_;
  std::unique_ptr<bus_service::Broker> broker_;
};

/// Publishes numbers, each in a ViewerProbe, on a topic of any name.
class NumberPublisher : public bus::Publisher {
 public:
  NumberPublisher(std::shared_ptr<bus::Context> context, std::string topic)
      : bus::Publisher(std::move(context)), topic_(std::move(topic)) {}

  void publish_number(std::uint64_t number, bool latch, const std::string& key,
                      const std::vector<bus::OutgoingTensor>& tensors) {
    const bus::MessageInfo info{.capture_ns = 0, .latch_key = key, .tensors = tensors};
    sequence_ = publish(Topic<wire::ViewerProbe>{topic_, latch}, info, [&](auto& builder, auto header) {
      const wire::Camera camera;
      return wire::CreateViewerProbe(builder, header, number, &camera);
    });
  }
  [[nodiscard]] std::uint64_t sequence() const { return sequence_; }  ///< of the last message

 private:
  std::string topic_;
  std::uint64_t sequence_ = 0;
};

inline void publish_number(NumberPublisher& publisher, std::uint64_t number, bool latch = false,
                           const std::string& key = "", const std::vector<bus::OutgoingTensor>& tensors = {}) {
  publisher.publish_number(number, latch, key, tensors);
}

inline std::uint64_t number_of(const bus::Message& message) {
  return message.root<wire::ViewerProbe>().probe_id();
}

/// The next message that carries a number (another sequence of the same topic may be under way).
inline std::optional<std::uint64_t> receive_number(bus::Subscriber& subscriber,
                                                   std::chrono::milliseconds timeout = patience) {
  const auto message = subscriber.receive(timeout);
  if (!message) return std::nullopt;
  return number_of(*message);
}

/// From here on nothing is lost to a connection's start.
inline void meet(const bus::Publisher& publisher, bus::Subscriber& subscriber) {
  ASSERT_TRUE(publisher.context()->wait_connected(patience));
  ASSERT_TRUE(subscriber.wait_connected(patience));
}

}  // namespace splatbus::bus_test
