#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <span>
#include <unordered_set>
#include <vector>

#include "expander/gaussian_inserter.h"

namespace splatbus::expander {

/// The batches that were handed to the trainer: repeated until model/published lists them, and kept for a trainer that
/// loses its model. Times are CLOCK_MONOTONIC nanoseconds.
class RetransmitQueue {
 public:
  struct Options {
    std::size_t in_flight = 6;  ///< at most this many are published and not acknowledged
    std::int64_t resend_ns = 1'000'000'000;
    std::size_t kept_bytes = std::size_t{256} << 20;  ///< of acknowledged batches, for a trainer that loses its model
  };

  explicit RetransmitQueue(const Options& options) : options_(options) {}

  void set_resend(std::int64_t resend_ns) { options_.resend_ns = resend_ns; }

  /// Takes a batch over and numbers it.
  void add(InsertBatch batch);

  /// Batches to publish now: new ones while there is room in flight, and those whose acknowledgement is late. Counts
  /// them as published at `now_ns`.
  [[nodiscard]] std::vector<const InsertBatch*> due(std::int64_t now_ns);

  /// Returns how many of them were pending.
  std::size_t acknowledge(std::span<const std::uint64_t> batches);

  /// Forgets pending batches for which `in_model` is true: a model was found to hold them.
  void acknowledge_if(const std::function<bool(const InsertBatch&)>& in_model);

  /// The trainer has lost everything: all batches that are kept become pending under new numbers.
  void restart();

  [[nodiscard]] std::vector<const InsertBatch*> pending_batches() const;
  [[nodiscard]] std::size_t pending() const { return pending_.size(); }
  [[nodiscard]] bool all_sent() const;  ///< every batch has been published once at least
  [[nodiscard]] bool ever_acknowledged() const { return acknowledged_ > 0; }
  [[nodiscard]] std::uint64_t gaussians() const { return gaussians_; }  ///< of all batches ever added
  [[nodiscard]] std::size_t forgotten() const { return forgotten_; }    ///< acknowledged batches dropped for room

 private:
  struct Entry {
    InsertBatch batch;
    std::int64_t sent_ns = 0;  // 0: never
  };
  void keep(Entry entry);

  Options options_;
  std::deque<Entry> pending_;  // oldest first
  std::deque<InsertBatch> kept_;
  std::size_t kept_bytes_ = 0;
  std::uint64_t last_batch_ = 0;
  std::uint64_t gaussians_ = 0;
  std::size_t acknowledged_ = 0, forgotten_ = 0;
};

}  // namespace splatbus::expander
