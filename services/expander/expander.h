#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>

#include "bus/publisher.h"
#include "bus/service.h"
#include "bus/subscriber.h"
#include "bus/tensor_ring.h"
#include "expander/gaussian_inserter.h"
#include "expander/model_sync.h"
#include "expander/parameters.h"
#include "expander/retransmit_queue.h"
#include "expander/viewpoints.h"

namespace splatbus::expander {

/// Counters of the expander, as heartbeats show them.
struct ExpanderCounters {
  std::uint64_t rounds = 0, rounds_lost = 0;
  std::uint64_t samples = 0, samples_invalid = 0;
  std::uint64_t samples_beyond = 0;                                       ///< too far from the origin of their frame
  std::uint64_t inserted_bare = 0, inserted_hole = 0, inserted_fill = 0;  ///< Gaussians, by InsertReasons
  std::uint64_t batches_sent = 0;
  double milliseconds = 0;          ///< the last round's
  double latency_milliseconds = 0;  ///< from a round's publication until its last batch was published
};

/// The service: turns rounds of input samples into Gaussians for the parts of the scene that the model lacks, and sees
/// to it that they reach the trainer. One thread calls step().
class Expander {
 public:
  /// `parameters` outlive the expander.
  Expander(std::shared_ptr<bus::Context> context, const bus::Parameters& parameters, Device backend = Device::Cpu);

  /// Handles what arrives within `timeout`, then what is due. Throws when memory or the device fails: the process is
  /// then to end, and the next one adopts what the trainer has.
  void step(std::chrono::milliseconds timeout);

  /// Takes no more rounds, and sees to it that the trainer gets what was inserted: false once it has all of it.
  [[nodiscard]] bool settle(std::chrono::milliseconds timeout);

  // succession.cpp
  /// What the one before has filled counts as filled. Before the first step.
  void adopt_handover();
  /// For the next process of this name.
  void leave_behind();

  [[nodiscard]] const ExpanderCounters& counters() const { return counters_; }
  [[nodiscard]] const GaussianInserter& inserter() const { return inserter_; }
  [[nodiscard]] const RetransmitQueue& queue() const { return queue_; }
  [[nodiscard]] const ModelSync& model_sync() const { return model_sync_; }

 private:
  struct Report {
    ModelReport report;
    bus::Message message;
  };
  struct Waiting {
    std::unique_ptr<Round> round;
    std::int64_t arrived_ns = 0;
  };

  void subscribe();
  void receive(std::chrono::milliseconds timeout);
  void handle_published(const wire::ModelPublished& published, const bus::Message& message);

  void follow_model();
  [[nodiscard]] bool adopt_model();
  void take_rounds();
  void insert_rounds();
  void insert(const Round& round);
  void publish_batches();
  void publish(const InsertBatch& batch);
  void publish_state();
  void prepare_ring();

  bus::LiveOptions<Options> options_;
  std::shared_ptr<bus::Context> context_;
  GaussianInserter inserter_;  // before what holds its rounds and batches
  bus::Subscriber subscriber_;
  bus::Publisher publisher_;
  bus::TensorRing ring_;
  RetransmitQueue queue_;
  ModelSync model_sync_;
  ExpanderCounters counters_;

  // What handlers have left for the rest of the step, where failures are not taken for a message's.
  std::deque<IncomingRound> incoming_;
  std::deque<Report> reports_;
  std::optional<bus::Message> model_;     // the newest model/published
  std::optional<PublishedModel> opened_;  // as it was read last: its pages stay mapped
  std::deque<Waiting> waiting_;           // rounds that are not in the model yet, oldest first
  Viewpoints viewpoints_;
  double steps_per_s_ = 0;  // of the optimizer, as it has told; 0: nothing yet
  std::size_t gaussian_limit_logged_ = 0;
  bool cell_limit_logged_ = false, beyond_logged_ = false;
  bool ring_prepared_ = false;
  std::int64_t model_read_ns_ = 0;
  std::int64_t unsent_since_ns_ = 0;  // publication of the round whose batches are not all published yet; 0: none
  bool state_changed_ = true;
  std::int64_t state_published_ns_ = 0, cells_repeated_ns_;
};

/// The service's main loop, until a stop is asked for.
void run(bus::ServiceContext& service);

}  // namespace splatbus::expander
