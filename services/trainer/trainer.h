#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <deque>
#include <exception>
#include <memory>
#include <optional>
#include <span>
#include <stop_token>
#include <thread>
#include <vector>

#include "bus/memory_pool.h"
#include "bus/publisher.h"
#include "bus/service.h"
#include "bus/subscriber.h"
#include "trainer/commands.h"
#include "trainer/insert_reader.h"
#include "trainer/optimizer.h"
#include "trainer/reference_reader.h"
#include "trainer/view_sampler.h"
#include "trainer/view_store.h"
#include "trainer/viewer_places.h"
#include "trainer/world_keeper.h"
#include "wire/model_generated.h"

namespace splatbus::trainer {

/// What training came to, for trainer/stats. Belongs to the optimizer's thread.
class Progress {
 public:
  void add(const StepReport& report);
  [[nodiscard]] double steps_per_s() const;  ///< over the last second of optimizer time
  [[nodiscard]] double views_per_s() const;
  [[nodiscard]] double loss() const { return loss_; }  ///< exponential mean over about 20 steps
  /// Of the pixels of the last second's views: nothing models yet what they show.
  [[nodiscard]] double masked_share() const;

 private:
  std::deque<StepReport> recent_;
  double recent_s_ = 0, recent_masked_ = 0, loss_ = 0;
  std::size_t recent_steps_ = 0, recent_views_ = 0;
  bool any_ = false;
};

/// The trainer service: one thread takes messages, another one owns the model and steps without end.
class Trainer {
 public:
  explicit Trainer(bus::ServiceContext& service, StepMaker make_step = make_gradient_step);

  /// Until `service.stop`. Throws bus::Error when no broker comes, and whatever memory, the device or the optimizer
  /// fail with: the model stays with the bus for the next trainer.
  void run();

 private:
  void open_store();

  // succession.cpp
  /// Of a successor: gets ready beside the trainer that runs, and waits for its place. False when it is not to be.
  [[nodiscard]] bool stand_by();
  void look_at_model(const wire::ModelPublished& published, const bus::Message& message);
  void publish_standby();
  /// Goes on with what the one before has left beside the model.
  void adopt_handover();
  /// Leaves it, after all that was published of the model.
  void hand_over(std::chrono::milliseconds patience = std::chrono::seconds(10));
  void leave_behind();

  // Message thread.
  void receive();
  void receive_once();
  void subscribe();
  void take_references(const std::vector<bus::Message>& messages);
  void take_reference(const bus::Message& message);
  void take_visibility(const wire::RelightVisibility& relit, const bus::Message& message);
  void take_insert(const bus::Message& message);
  /// Counts a command that the queue has no room for, and says so once: the expander repeats a batch.
  void refuse(const bus::Message& message);

  // Optimizer thread.
  void optimize(const std::stop_token& stop);
  void optimize_once();
  void refresh_options();
  /// Tells the views which of them may train.
  void pair_views();
  [[nodiscard]] bool may_step() const;
  void train_step();
  /// Books what steps came to.
  void take(const StepReport& report);
  /// Waits for what is under way. Returns whether the structure changed.
  bool finish_steps();
  /// Of the kept views those that show something else than these new pictures.
  void drop_untrue(std::span<const TrainingViewPtr> pictures);
  void publish_due(bool structure_changed);
  void publish_stats(bool stopped);

  bus::ServiceContext& service_;
  bus::Publisher publisher_;
  bus::Subscriber subscriber_;
  ViewStore views_;
  CommandQueue commands_;
  std::atomic<bool> with_depth_{false};
  std::atomic<bool> optimizer_failed_{false};
  std::exception_ptr optimizer_failure_;             ///< once its thread has ended
  std::atomic<std::uint64_t> host_copied_bytes_{0};  ///< bulk data that passed through host memory
  ReferenceReader references_;
  InsertReader inserts_;
  bus::MemoryPool visibilities_;
  std::uint64_t lost_tensors_ = 0, dropped_rows_ = 0, refused_commands_ = 0, untrue_views_ = 0;

  std::unique_ptr<model::PageStore> store_;
  ViewerPlaces viewers_;
  std::unique_ptr<WorldKeeper> keeper_;  ///< null without a world folder
  StepMaker make_step_;
  std::unique_ptr<Optimizer> optimizer_;
  ViewSampler sampler_;
  Progress progress_;
  bus::LiveOptions<Options> options_;

  /// What is announced at once when it changes.
  struct State {
    std::optional<std::uint64_t> finished_at;  ///< step, when run_until is reached
    bool paused = false;
    std::uint64_t cameras = 0;
    bool operator==(const State&) const = default;
  };
  State announced_;
  bool successor_ = false;
  /// While it stands by.
  struct Before {
    bool adoptable = false;            ///< the model that the one before has published
    int refusals = 0;                  ///< of it, one after the other
    std::optional<std::size_t> views;  ///< that the one before has, once it has said so
  };
  Before before_;
  std::string before_failure_;  ///< why it cannot go on with that model
  using Clock = std::chrono::steady_clock;
  Clock::time_point model_published_{}, stats_published_{};
};

}  // namespace splatbus::trainer
