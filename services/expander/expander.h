#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "bus/publisher.h"
#include "bus/service.h"
#include "bus/subscriber.h"
#include "bus/tensor_ring.h"
#include "expander/batch_ledger.h"
#include "expander/mapper.h"
#include "expander/model_follower.h"
#include "expander/parameters.h"
#include "expander/waiting_rounds.h"

namespace splatbus::expander {

/// Counters of the expander, as heartbeats show them.
struct ExpanderCounters {
  std::uint64_t rounds = 0, rounds_lost = 0;
  std::uint64_t samples = 0, samples_dropped = 0, samples_unseen = 0;
  std::uint64_t batches_sent = 0;
  std::uint64_t failures = 0;       ///< of memory or the device, that this process has lived through
  std::uint64_t cells = 0;          ///< as published last
  double milliseconds = 0;          ///< the last round's
  double latency_milliseconds = 0;  ///< from a round's publication until its last batch was published
};

/// The service: turns rounds of input samples into Gaussians for the parts of the scene that the model lacks, and sees
/// to it that they reach the trainer. One thread calls step().
class Expander {
 public:
  /// `parameters` outlive the expander. Throws when the backend cannot be had.
  Expander(std::shared_ptr<bus::Context> context, const bus::Parameters& parameters, Device backend = Device::Cpu);

  /// Handles what arrives within `timeout`, then what is due. What there is no memory for is logged and tried again
  /// after `retry_s`. Throws when the backend has failed for good.
  void step(std::chrono::milliseconds timeout);

  [[nodiscard]] const ExpanderCounters& counters() const { return counters_; }
  [[nodiscard]] Mapper& mapper() { return *mapper_; }
  [[nodiscard]] const BatchLedger& ledger() const { return ledger_; }
  [[nodiscard]] const ModelFollower& follower() const { return follower_; }

 private:
  void subscribe();
  void handle_input(const bus::Message& message);
  void handle_pose(const wire::ViewerPose& pose);
  void handle_published(const wire::ModelPublished& published, const bus::Message& message);

  void process_waiting();
  [[nodiscard]] std::unique_ptr<Round> take(const IncomingRound& incoming);
  void grow(const Round& round);
  void publish_batches();
  void publish(const InsertBatch& batch);
  void publish_state();
  void send_state();
  void prepare_ring();
  [[nodiscard]] std::int64_t retry_ns() const;
  /// Does a part of a step whose failure another try can mend; false when it failed. Throws when none can.
  bool attempt(const char* what, const std::function<void()>& part);
  void live_through(const std::string& failure);

  bus::LiveOptions<Options> options_;
  std::shared_ptr<bus::Context> context_;
  std::unique_ptr<Mapper> mapper_;  // before what holds its rounds and batches
  bus::Subscriber subscriber_;
  bus::Publisher publisher_;
  bus::TensorRing ring_;
  BatchLedger ledger_;
  ModelFollower follower_;
  ExpanderCounters counters_;

  WaitingRounds waiting_;
  std::optional<glm::vec3> viewer_;
  std::size_t gaussian_limit_logged_ = 0;
  bool ring_prepared_ = false;
  std::int64_t unsent_since_ns_ = 0;  // publication of the round whose batches are not all published yet; 0: none
  bool state_changed_ = true;
  std::int64_t state_published_ns_ = 0, state_retry_ns_ = 0;
};

/// The service's main loop, until a stop is asked for.
void run(bus::ServiceContext& service);

}  // namespace splatbus::expander
