#pragma once

#include <chrono>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "pipeline_watch.h"
#include "probe_round.h"
#include "supervised_run.h"

namespace splatbus::cli {

/// Every service as a process of its own, small, on a bus of its own, under the supervisor.
class Pipeline {
 public:
  explicit Pipeline(const std::string& launch_file = Pipeline::launch_file());

  /// The launch file, as text.
  [[nodiscard]] static std::string launch_file();

  [[nodiscard]] bus::Address address() const { return folder_.address(); }
  [[nodiscard]] const std::shared_ptr<bus::Context>& context() const { return context_; }
  [[nodiscard]] const PipelineState& state() const { return watch_.state(); }
  [[nodiscard]] std::map<std::string, pid_t> pids() const;
  [[nodiscard]] ProcessStatus status(const std::string& name) const;

  /// Polls until `condition` holds. False after a patience that is long, since machines differ.
  [[nodiscard]] bool wait_until(const std::function<bool()>& condition);

  /// Asks for a held-out view, again and again, until the viewer has compared one whose SSIM is at least `ssim`: the
  /// whole way from engine to viewer and back works.
  [[nodiscard]] bool wait_for_picture(double ssim);

  [[nodiscard]] std::uint16_t gateway_port() const;

  /// What the services said, for the message of a test that failed.
  [[nodiscard]] std::string log() const;

 private:
  PrivateBusFolder folder_;
  std::shared_ptr<bus::Context> context_;
  PipelineWatch watch_;
  ProbeRounds probes_;
  std::string url_;
  SupervisedRun run_;
};

}  // namespace splatbus::cli
