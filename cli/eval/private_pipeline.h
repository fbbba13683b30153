#pragma once

#include <chrono>
#include <filesystem>
#include <memory>
#include <optional>
#include <vector>

#include "bus/context.h"
#include "control_server.h"
#include "log_store.h"
#include "model/live_scene.h"
#include "pipeline_watch.h"
#include "supervised_run.h"

namespace splatbus::cli {

/// Services that a command runs for itself, on a bus of their own unless it is told another, and what they say. Not
/// thread-safe.
class PrivatePipeline {
 public:
  /// Nothing runs yet: whoever is not to miss the first messages subscribes before start(). `signals` lives longer.
  PrivatePipeline(const StopSignals& signals, std::filesystem::path log,
                  const std::optional<bus::Address>& elsewhere = {});
  ~PrivatePipeline();
  PrivatePipeline(const PrivatePipeline&) = delete;
  PrivatePipeline& operator=(const PrivatePipeline&) = delete;

  [[nodiscard]] const bus::Address& address() const { return address_; }
  [[nodiscard]] const std::filesystem::path& folder() const { return folder_.path(); }  ///< goes with this
  [[nodiscard]] const std::shared_ptr<bus::Context>& context() const { return context_; }
  [[nodiscard]] const std::filesystem::path& log() const { return log_; }

  /// Once.
  void start(const LaunchPlan& plan) { run_.emplace(plan, log_); }
  /// The same, and the operator's verbs (status, swap, logs, down ...) are answered on this bus. `file` is what was
  /// planned.
  void start(const LaunchPlan& plan, const LaunchFile& file);
  /// Takes in what has come, and waits for it up to `timeout`. Throws std::runtime_error when a service has failed for
  /// good, or the user interrupts.
  void poll(std::chrono::milliseconds timeout);
  void stop();  ///< every service

  [[nodiscard]] const PipelineState& state() const { return watch_.state(); }
  [[nodiscard]] LiveScene& live() { return live_; }
  [[nodiscard]] const LiveScene& live() const { return live_; }
  /// Whether there is a model with anything in it.
  [[nodiscard]] bool has_gaussians() const { return live_.published() && live_.published()->count > 0; }
  [[nodiscard]] std::vector<ProcessStatus> processes() const { return run_->status(); }

 private:
  const StopSignals& signals_;
  std::filesystem::path log_;
  PrivateBusFolder folder_, logs_folder_;
  bus::Address address_;
  std::shared_ptr<bus::Context> context_;
  PipelineWatch watch_;
  LiveScene live_;
  std::stop_source down_;  ///< as an operator asks
  std::optional<ControlServer> control_;
  std::optional<LogStore> logs_;
  std::optional<SupervisedRun> run_;  ///< writes to those above
};

}  // namespace splatbus::cli
