#include "bus/broker.h"

#include <fmt/format.h>

#include <string>
#include <utility>

#include "bus/directory_lock.h"
#include "bus/error.h"
#include "bus/relay.h"
#include "bus/slab_registry.h"

namespace splatbus::bus_service {
struct Broker::Impl {
  BrokerOptions options;
  // In this order: the lock is the first to be taken and the last to go.
  std::optional<DirectoryLock> lock;
  std::optional<SlabRegistry> registry;
  std::optional<Relay> relay;
};

Broker::Broker(BrokerOptions options) : impl_(std::make_unique<Impl>()) {
  impl_->options = std::move(options);
}
Broker::~Broker() {
  stop();
}

void Broker::start() {
  const auto& address = impl_->options.address;
  if (!address.is_local()) {
    throw bus::Error(fmt::format("{}: a broker needs an ipc:// folder; tcp comes on top of it", address.text()));
  }
  impl_->lock.emplace(*address.directory);
  try {
    impl_->registry.emplace(address.slab_socket(), impl_->options.slab_grace);
    impl_->relay.emplace(
        impl_->options, [this](std::uint64_t id) { return impl_->registry->find(id); },
        [this] { return impl_->registry->size(); });
  } catch (...) {
    stop();
    throw;
  }
}

void Broker::stop() {
  impl_->relay.reset();
  impl_->registry.reset();
  impl_->lock.reset();
}

bool Broker::intact() const {
  return !impl_->lock || impl_->lock->intact();
}

const bus::Address& Broker::address() const {
  return impl_->options.address;
}

std::optional<bus::Address> Broker::tcp_address() const {
  if (!impl_->relay || !impl_->options.tcp_host) return std::nullopt;
  bus::Address address;
  address.host = *impl_->options.tcp_host == "*" ? "127.0.0.1" : *impl_->options.tcp_host;
  address.port = impl_->relay->tcp_port();
  return address;
}

BrokerStatistics Broker::statistics() const {
  return impl_->relay ? impl_->relay->statistics() : BrokerStatistics{};
}

}  // namespace splatbus::bus_service
