#include "start_evaluation.h"

#include <fmt/format.h>

#include <stdexcept>

#include "figures.h"
#include "pipeline_watch.h"
#include "schema_json.h"
#include "supervised_run.h"
#include "verbs.h"

namespace splatbus::cli {

namespace {

constexpr std::int64_t kShowNs = 1'000'000'000;

}  // namespace

nlohmann::json run_start_evaluation(const EvaluationSetup& setup, const StopSignals& signals,
                                    const std::function<void(const std::string&)>& show_state) {
  std::filesystem::create_directories(setup.out);
  const PrivateBusFolder folder;
  LaunchPlan plan = plan_evaluation(setup, folder.address(), false);
  const auto context = connect_later(folder.address());
  PipelineWatch watch(context);
  StartWatch start(context, setup.enough_gaussians());
  SupervisedRun run(std::move(plan), setup.out / "services.log");

  const std::int64_t end_ns = bus::now_ns() + static_cast<std::int64_t>(setup.timeout_s * 1e9);
  std::int64_t shown_ns = 0;
  // The bytes copied are those of the heartbeats and statistics, which come a moment later.
  const auto told = [&] { return watch.state().trainer.gaussians >= setup.enough_gaussians(); };
  while (!start.complete() || !told()) {
    run.check();
    const auto& trainer = watch.state().trainer;
    const std::string state =
        fmt::format("{} of {} Gaussians, step {}, references {}/{}", trainer.gaussians, setup.enough_gaussians(),
                    trainer.step, trainer.ready_references, setup.cameras);
    if (signals.stop().stop_requested()) throw std::runtime_error("interrupted");
    if (bus::now_ns() > end_ns) {
      throw std::runtime_error(fmt::format("the model did not come within {} s ({}); see {}", setup.timeout_s, state,
                                           (setup.out / "services.log").string()));
    }
    start.poll(std::chrono::milliseconds(20));
    watch.poll(std::chrono::milliseconds(0));
    if (bus::now_ns() - shown_ns > kShowNs) {
      show_state(state);
      shown_ns = bus::now_ns();
    }
  }
  nlohmann::json summary = start.summary();
  summary["gaussians"] = watch.state().trainer.gaussians;
  summary["step"] = watch.state().trainer.step;
  summary["host_copied_bytes"] = watch.state().trainer.host_copied_bytes;
  summary["host_copied_bytes_by_service"] = host_copied_bytes(run.status());
  write_text(setup.out / "summary.json", json_text(summary, 2) + "\n");
  run.stop();
  return summary;
}

}  // namespace splatbus::cli
