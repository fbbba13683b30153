#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "bus/publisher.h"
#include "evaluation_setup.h"
#include "private_pipeline.h"
#include "probe_round.h"

namespace splatbus::cli {

/// A pipeline on a bus of its own whose trainer goes on only as far as it is told, and held-out cameras beside it. Not
/// thread-safe.
class StagedTraining {
 public:
  /// Starts the services. What is passed by reference lives longer.
  StagedTraining(const EvaluationSetup& setup, std::vector<Camera> held_out, const StopSignals& signals,
                 const std::function<void(const std::string&)>& show_state);

  /// Until every camera's picture is at the trainer, every sample in the model, and the engine's held-out pictures
  /// here.
  void prepare();

  /// Until the trainer has stopped at `step`. Throws when it went past.
  void train_until(std::uint64_t step);

  /// A new round of held-out pictures; asks again for those that do not come.
  void ask_held_out();

  /// Polls until `condition` holds. Throws std::runtime_error that says what did not come in the setup's time, that a
  /// service has failed, or that the user interrupts.
  void wait_until(const std::string& what, const std::function<bool()>& condition,
                  const std::function<std::string()>& describe);

  [[nodiscard]] const PipelineState& state() const { return pipeline_.state(); }
  [[nodiscard]] LiveScene& live() { return pipeline_.live(); }
  [[nodiscard]] const ProbeRounds& held_out() const { return probes_; }
  [[nodiscard]] const StartWatch& start() const { return start_; }
  [[nodiscard]] std::vector<ProcessStatus> processes() const { return pipeline_.processes(); }
  void stop() { pipeline_.stop(); }  ///< every service
  [[nodiscard]] bus::Publisher& publisher() { return publisher_; }
  [[nodiscard]] const std::shared_ptr<bus::Context>& context() const { return pipeline_.context(); }

 private:
  void ask_again_for_missing();

  const EvaluationSetup& setup_;
  const std::function<void(const std::string&)>& show_state_;
  PrivatePipeline pipeline_;
  StartWatch start_;
  ProbeRounds probes_;
  bus::Publisher publisher_;
  std::int64_t asked_ns_ = 0;
};

}  // namespace splatbus::cli
