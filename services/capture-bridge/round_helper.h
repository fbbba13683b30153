#pragma once

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>

#include "bus/memory_pool.h"
#include "bus/publisher.h"
#include "bus/subscriber.h"
#include "bus/tensor_ring.h"
#include "capture-bridge/round_message.h"
#include "capture-bridge/sampler.h"

namespace splatbus::capture_bridge {

/// What a bridge does that does not lead: it samples the rounds that it is given, one at a time, and answers. It knows
/// nothing but what such a round says. One thread.
class RoundHelper {
 public:
  /// Rounds are kept and sampled where `backend` says; `expected` is what is to be expected of one. Throws
  /// std::runtime_error when the backend cannot be had.
  RoundHelper(const std::shared_ptr<bus::Context>& context, Device backend, const RoundSizes& expected);

  /// Offers itself, and samples what comes within `timeout`; a round's sampling is waited for. Throws bus::Error when
  /// the device has failed for good.
  void step(std::chrono::milliseconds timeout);

  struct Counters {
    std::uint64_t rounds = 0, refused = 0;
    std::size_t samples = 0;  ///< of the last round
    double milliseconds = 0;  ///< the last round's sampling
  };
  [[nodiscard]] const Counters& counters() const { return counters_; }
  [[nodiscard]] std::uint64_t host_copied_bytes() const { return host_copied_bytes_; }

  static constexpr std::int64_t kOfferEveryNs = 1'000'000'000;

 private:
  void handle(const wire::SamplingRound& round, const bus::Message& message);
  void answer(const ForeignRound& round, std::int64_t capture_ns);
  void refuse(std::uint64_t job, const std::string& reason);

  std::string own_;
  bus::Subscriber subscriber_;
  bus::Publisher publisher_;
  bus::MemoryPool pictures_;
  bus::TensorRing ring_;
  Sampler sampler_;
  Counters counters_;
  std::atomic<std::uint64_t> host_copied_bytes_ = 0;
  std::uint64_t refused_ = 0;  // messages
  bool connected_ = false;
  std::int64_t next_offer_ns_ = 0;
};

}  // namespace splatbus::capture_bridge
