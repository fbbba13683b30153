#include "bus/broker.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <string>
#include <utility>

#include "bus/error.h"
#include "bus/file_descriptor.h"
#include "bus/private_folder.h"
#include "bus/relay.h"
#include "bus/slab_registry.h"

namespace splatbus::bus_service {
namespace {

/// Makes the bus's folder, with mode 0700, and holds its lock file: binding an ipc:// path that is in use would succeed
/// and steal it. The kernel lets go of the lock when its holder dies, so that a killed broker is no hindrance.
class DirectoryLock {
 public:
  /// Throws bus::Error naming the folder: it cannot be made, is another user's, or another broker holds it.
  explicit DirectoryLock(const std::string& directory);

 private:
  bus::FileDescriptor file_;
};

std::string read_holder(int file) {
  char text[32] = {};
  const auto length = ::pread(file, text, sizeof(text) - 1, 0);
  return length > 0 ? std::string(text, static_cast<std::size_t>(length)) : "unknown";
}

DirectoryLock::DirectoryLock(const std::string& directory) {
  bus::require_private_folder(directory);
  const auto path = directory + "/lock";
  file_ = bus::FileDescriptor(::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600));
  if (!file_.valid()) throw bus::Error(fmt::format("{}: cannot open it: {}", path, std::strerror(errno)));
  if (::flock(file_.get(), LOCK_EX | LOCK_NB) != 0) {
    throw bus::Error(
        fmt::format("bus folder {}: a broker runs there already (process {})", directory, read_holder(file_.get())));
  }
  const auto pid = fmt::format("{}", ::getpid());
  if (::ftruncate(file_.get(), 0) != 0 || ::pwrite(file_.get(), pid.data(), pid.size(), 0) < 0) {
    throw bus::Error(fmt::format("{}: cannot write to it: {}", path, std::strerror(errno)));
  }
}

}  // namespace

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
    impl_->registry.emplace(address.slab_socket());
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
