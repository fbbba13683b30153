#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <utility>

#include "gateway/traffic.h"

namespace splatbus::gateway {

/// Bounds connections, overall and from one address. One thread; outlives its leases.
class ConnectionCounts {
 public:
  ConnectionCounts(std::size_t most, std::size_t most_of_address, Traffic& traffic)
      : most_(most), most_of_address_(most_of_address), traffic_(traffic) {}

  /// One connection, counted while this lives.
  class Lease {
   public:
    Lease(Lease&& other) noexcept
        : counts_(std::exchange(other.counts_, nullptr)), address_(std::move(other.address_)) {}
    Lease& operator=(Lease&&) = delete;
    ~Lease() {
      if (counts_ != nullptr) counts_->release(address_);
    }

    [[nodiscard]] const std::string& address() const { return address_; }

   private:
    friend class ConnectionCounts;
    Lease(ConnectionCounts& counts, std::string address) : counts_(&counts), address_(std::move(address)) {}
    ConnectionCounts* counts_;
    std::string address_;
  };

  /// `address`: what counts as one, such as the bytes of an IPv4 address or of an IPv6 /64.
  [[nodiscard]] std::optional<Lease> admit(const std::string& address) {
    const auto known = of_address_.find(address);
    if (traffic_.connections >= most_ || (known != of_address_.end() && known->second >= most_of_address_)) {
      traffic_.refuse(Refusal::Busy);
      return std::nullopt;
    }
    ++of_address_[address];
    ++traffic_.connections;
    return Lease(*this, address);
  }

 private:
  void release(const std::string& address) {
    --traffic_.connections;
    const auto known = of_address_.find(address);
    if (--known->second == 0) of_address_.erase(known);
  }

  std::size_t most_, most_of_address_;
  Traffic& traffic_;
  std::map<std::string, std::size_t> of_address_;
};

}  // namespace splatbus::gateway
