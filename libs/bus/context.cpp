#include "bus/context.h"

#include <fmt/format.h>
#include <sys/random.h>

#include <cstdint>
#include <utility>

#include "bus/context_impl.h"
#include "bus/error.h"
#include "bus/frames.h"
#include "bus/private_folder.h"
#include "bus/slab_memory.h"

namespace splatbus::bus {
namespace {

constexpr std::size_t max_source_length = 64;
constexpr std::int64_t cache_ns = 10'000'000'000;  // a slab nobody has used for that long is unmapped

std::string checked_source(std::string source) {
  bool good = !source.empty() && source.size() <= max_source_length;
  for (const char c : source) good = good && c > 0x20 && c < 0x7f;
  if (!good) throw Error(fmt::format("'{}' is not a valid name for a source on the bus", printable(source)));
  return source;
}

// Nobody else's bus is connected to.
std::optional<ClientKeys> keys_of(const Address& address) {
  if (address.is_local()) require_private_folder(*address.directory);
  return client_keys(address.publish_endpoint(), address.key_file, address.server_key);
}

std::uint64_t random_id() {
  std::uint64_t id = 0;
  do {
    if (::getrandom(&id, sizeof(id), 0) != sizeof(id)) throw Error("cannot read random bytes");
  } while (id == 0);
  return id;
}

}  // namespace

Context::Impl::Impl(Address bus_address, std::string source_name)
    : address(std::move(bus_address)),
      source(checked_source(std::move(source_name))),
      epoch(static_cast<std::uint64_t>(now_ns())),
      keys(keys_of(address)),
      slabs(address.is_local() ? std::make_unique<SlabClient>(address.slab_socket()) : nullptr),
      outbox(zmq, address, keys, slabs.get()) {}

void Context::Impl::forget_unused(std::int64_t now) {
  std::erase_if(cache, [&](const auto& entry) {
    return entry.second.slab.use_count() == 1 && now - entry.second.used_ns > cache_ns;
  });
}

Context::Context(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Context::~Context() = default;

std::shared_ptr<Context> Context::create(Address address, std::string source) {
  return std::shared_ptr<Context>(new Context(std::make_unique<Impl>(std::move(address), std::move(source))));
}

const Address& Context::address() const {
  return impl_->address;
}
const std::string& Context::source() const {
  return impl_->source;
}
std::uint64_t Context::epoch() const {
  return impl_->epoch;
}
void* Context::zmq_context() const {
  return impl_->zmq.handle();
}

bool Context::wait_connected(std::chrono::milliseconds timeout) const {
  return impl_->outbox.wait_connected(timeout);
}

std::shared_ptr<Slab> Context::create_slab(const std::string& role, std::size_t slots, std::size_t slot_bytes,
                                           int timeout_ms, Device kind, SlabLife life) {
  auto slab = make_slab(role, slots, slot_bytes, kind, life);
  if (!register_slab(slab, std::chrono::milliseconds(timeout_ms))) {
    throw Error(fmt::format("slab '{}': no broker answers at {}", slab->name(), impl_->address.slab_socket()));
  }
  return slab;
}

std::shared_ptr<Slab> Context::make_slab(const std::string& role, std::size_t slots, std::size_t slot_bytes,
                                         Device kind, SlabLife life) {
  SlabDescriptor descriptor;
  descriptor.kind = kind;
  descriptor.id = random_id();
  descriptor.name = fmt::format("{}/{}", source(), role);
  descriptor.slots = slots;
  descriptor.slot_bytes = slot_bytes;
  descriptor.kept = life == SlabLife::ForSuccessor;
  auto slab = create_slab_memory(descriptor, impl_->address.is_local());
  if (!impl_->slabs) {
    const std::scoped_lock lock(impl_->mutex);
    std::erase_if(impl_->private_slabs, [](const auto& entry) { return entry.second.expired(); });
    impl_->private_slabs[descriptor.id] = slab;
  }
  return slab;
}

bool Context::register_slab(const std::shared_ptr<Slab>& slab, std::chrono::milliseconds timeout) {
  return !impl_->slabs || impl_->slabs->add(slab, timeout);
}

std::shared_ptr<Slab> Context::open_slab(std::uint64_t id) {
  if (!impl_->slabs) return nullptr;
  const std::int64_t now = now_ns();
  {
    const std::scoped_lock lock(impl_->mutex);
    if (const auto found = impl_->cache.find(id); found != impl_->cache.end()) {
      found->second.used_ns = now;
      return found->second.slab;
    }
  }
  auto answer = impl_->slabs->open(id, "", std::chrono::milliseconds(0));
  if (!answer) return nullptr;
  if (answer->descriptor.id != id) throw Error(fmt::format("slab registry: asked for {:#x}, got another", id));
  auto slab = map_slab_memory(answer->descriptor, std::move(answer->control), std::move(answer->data), false);
  const std::scoped_lock lock(impl_->mutex);
  impl_->forget_unused(now);
  impl_->cache[id] = {slab, now};
  return slab;
}

std::shared_ptr<Slab> Context::adopt_slab(const std::string& name, int timeout_ms) {
  if (!impl_->slabs) return nullptr;
  auto answer = impl_->slabs->open(0, name, std::chrono::milliseconds(timeout_ms));
  if (!answer) return nullptr;
  auto slab = map_slab_memory(answer->descriptor, std::move(answer->control), std::move(answer->data), true);
  impl_->slabs->keep(slab);
  return slab;
}

void Context::fall_silent() {
  impl_->outbox.close();
}

void Context::claim(std::chrono::milliseconds timeout) {
  claim_part(source(), timeout);
}

void Context::claim_part(const std::string& part, std::chrono::milliseconds timeout) {
  if (impl_->slabs) impl_->slabs->claim(part, timeout);
}

void Context::drop_slab(const std::string& role) {
  if (impl_->slabs) impl_->slabs->drop(fmt::format("{}/{}", source(), role));
}

}  // namespace splatbus::bus
