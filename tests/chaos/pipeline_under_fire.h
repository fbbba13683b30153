#pragma once

#include <chrono>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "../integration/command.h"
#include "child_process.h"
#include "model/live_scene.h"
#include "pipeline_watch.h"
#include "probe_round.h"
#include "supervised_run.h"

namespace splatbus::chaos {

/// What the processes of a pipeline take, by source.
struct Usage {
  std::map<std::string, std::size_t> resident_bytes, descriptors;
  double slabs = 0;             ///< in the registry
  std::set<std::string> files;  ///< in the bus's folder
};

/// The pipeline of the integration tests under `splatbus launch`, a process of its own, which can die too.
class PipelineUnderFire {
 public:
  PipelineUnderFire();
  /// `held_out`: views that it asks for, around the scene.
  explicit PipelineUnderFire(const std::string& launch_file, int held_out = 1);

  /// Of the supervisor and each service that was heard of, by name; those that are gone among them.
  [[nodiscard]] std::map<std::string, pid_t> pids() const;
  static constexpr const char* kSupervisor = "supervisor";

  /// After the supervisor was killed: waits until nobody of it is left, and starts it again.
  [[nodiscard]] bool start_again();

  /// Every service is alive, those of `killed` as other processes, and of each held-out view a picture that was asked
  /// for from now on has come back to the viewer; the newest have that SSIM in the mean. False after a patience that is
  /// long.
  [[nodiscard]] bool wait_until_well(double ssim, const std::map<std::string, pid_t>& killed);
  [[nodiscard]] bool wait_until(const std::function<bool()>& condition);
  /// Polls meanwhile.
  void let_pass(std::chrono::milliseconds time);

  /// `splatbus VERB...` on this bus, to its end; polls meanwhile.
  [[nodiscard]] cli::Answer operate(std::vector<std::string> verb);
  /// The same, begun; poll() with let_pass() until it ends. Its lines come with its end.
  [[nodiscard]] cli::ChildProcess begin(std::vector<std::string> verb) const;
  /// Of a service's newest heartbeat.
  struct Heard {
    std::string backend;
    std::map<std::string, double> counters;
  };
  [[nodiscard]] const Heard& heard(const std::string& name) const { return nodes_.at(name).heard; }
  /// Of a successor that gets ready now; 0 when there is none.
  [[nodiscard]] pid_t successor_of(const std::string& name) const;

  /// The viewer's picture of each held-out view against the engine's, asked for twice a second from now on.
  void sample_pictures() { sampling_ = true; }
  struct Sample {
    std::int64_t time_ns = 0;  ///< when the answer came
    double ssim = 0;
    double level = 0;  ///< mean of each view's newest, of those that have one
  };
  [[nodiscard]] const std::vector<Sample>& samples() const { return samples_; }

  [[nodiscard]] Usage usage() const;
  /// Of the trainer that has published the newest model.
  [[nodiscard]] std::uint64_t model_epoch() const { return model_epoch_; }
  [[nodiscard]] const cli::PipelineState& state() const { return watch_->state(); }
  /// Of the last pictures of wait_until_well().
  [[nodiscard]] double ssim() const { return ssim_; }
  /// Ids of the model as it is now; nullopt when none could be had.
  [[nodiscard]] std::optional<std::vector<std::uint64_t>> gaussian_ids();
  [[nodiscard]] std::size_t log_bytes() const { return log_bytes_; }
  /// The last of it.
  [[nodiscard]] std::string log() const;
  /// SIGTERM, and what is left of it a while later: processes that name the bus's folder.
  [[nodiscard]] std::set<std::string> stop();

 private:
  void start();
  void poll(std::chrono::milliseconds timeout);
  void take_output();
  void take_sample();
  [[nodiscard]] bool all_alive(const std::map<std::string, pid_t>& killed) const;
  [[nodiscard]] std::set<std::string> survivors() const;

  struct Node {
    pid_t pid = 0;
    std::int64_t heard_ns = 0;
    bool runs = false;
    Heard heard;
  };
  cli::PrivateBusFolder bus_, files_;
  std::shared_ptr<bus::Context> context_;
  std::unique_ptr<cli::PipelineWatch> watch_;
  std::unique_ptr<cli::ProbeRounds> probes_;
  std::unique_ptr<LiveScene> scene_;
  std::unique_ptr<bus::Subscriber> heartbeats_;
  std::unique_ptr<cli::ChildProcess> supervisor_;
  std::map<std::string, Node> nodes_;
  double slabs_ = 0, ssim_ = 0;
  std::uint64_t model_epoch_ = 0;
  bool sampling_ = false;
  std::int64_t sampled_ns_ = 0;
  std::uint64_t newest_sample_ = 0;            ///< probe
  std::map<std::size_t, double> newest_ssim_;  ///< by view
  std::vector<Sample> samples_;
  std::size_t log_bytes_ = 0;
  std::vector<std::string> last_lines_;
};

}  // namespace splatbus::chaos
