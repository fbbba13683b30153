#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <unordered_map>
#include <zmq.hpp>

#include "bus/context.h"
#include "bus/curve.h"
#include "bus/frames.h"
#include "bus/outbox.h"
#include "bus/slab_client.h"
#include "bus/subscriber.h"

namespace splatbus::bus {

struct Context::Impl {
  Impl(Address address, std::string source);

  struct CachedSlab {
    std::shared_ptr<Slab> slab;
    std::int64_t used_ns = 0;
  };
  void forget_unused(std::int64_t now);

  const Address address;
  const std::string source;
  const std::uint64_t epoch;
  const std::optional<ClientKeys> keys;  // over tcp, where it takes some
  /// Null over tcp. Goes after the outbox: who gets the lease finds the name free.
  const std::unique_ptr<SlabClient> slabs;
  zmq::context_t zmq;
  Outbox outbox;
  std::mutex mutex;
  std::unordered_map<std::uint64_t, CachedSlab> cache;                   // opened, read-only
  std::unordered_map<std::uint64_t, std::weak_ptr<Slab>> private_slabs;  // over tcp
};

struct Message::Content {
  Frames frames;
};

}  // namespace splatbus::bus
