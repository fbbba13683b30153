#include <sys/resource.h>

#include <chrono>
#include <map>

#include "bench/bench_scene.h"
#include "bench/roofline.h"
#include "raster/adam.h"
#include "raster/loss.h"

namespace splatbus::bench {
namespace {

constexpr std::uint32_t kTileSide = 8;  // of the CPU rasteriser, pixels

using Clock = std::chrono::steady_clock;

class Stages {
 public:
  template <class Body>
  void time(const std::string& name, const Body& body) {
    const auto begin = Clock::now();
    body();
    add(name, std::chrono::duration<double, std::milli>(Clock::now() - begin).count());
  }
  void add(const std::string& name, double milliseconds) { step_[name] += milliseconds; }
  void end_step(bool counted) {
    for (const auto& [name, milliseconds] : step_) {
      if (counted) all_[name].push_back(milliseconds);
    }
    step_.clear();
  }
  [[nodiscard]] nlohmann::json medians() const {
    nlohmann::json out;
    for (const auto& [name, values] : all_) out[name] = median(values);
    return out;
  }

 private:
  std::map<std::string, double> step_;
  std::map<std::string, std::vector<double>> all_;
};

}  // namespace

nlohmann::json run_cpu(const Arguments& arguments) {
  Workload workload(arguments);
  const GaussiansBuffer& model = workload.model;
  const std::vector<Camera>& cameras = workload.cameras;
  const SceneState& scene = workload.scene;
  const auto rasterizer = raster::make_cpu_rasterizer(arguments.threads);
  const bool transfer = workload.transfer();

  raster::Render render;
  std::vector<std::vector<std::uint8_t>> targets;
  double mean_image = 0;
  for (const Camera& camera : cameras) {
    rasterizer->render(workload.view(), camera, scene, {}, render);
    if (targets.empty()) mean_image = mean_of(render.color);
    targets.push_back(to_target(render.color, transfer));
  }
  if (arguments.mode == "train") workload.disturb();
  const GaussiansView gaussians = workload.view();

  raster::ParameterGradient gradient;
  gradient.active_channels = arguments.active_channels;
  raster::RenderGradient render_gradient;
  raster::Adam adam;
  adam.resize(model.layout(), gaussians.count);
  const std::vector<float> rates = learning_rates(model.layout());
  const raster::LossOptions loss_options{.encode_srgb = transfer, .threads = arguments.threads};

  const bool fused = arguments.batch == 1 && !arguments.separate_adam;

  Stages stages;
  std::vector<double> milliseconds;
  double loss = 0;
  std::size_t view = 0;
  for (int step = -arguments.warmup; step < arguments.iterations; ++step) {
    const auto begin = Clock::now();
    if (arguments.mode == "train") {
      stages.time("clear",
                  [&] { fused ? gradient.clear_statistics(gaussians) : gradient.clear(gaussians, arguments.threads); });
    }
    for (int b = 0; b < arguments.batch; ++b, view = (view + 1) % cameras.size()) {
      if (arguments.mode == "train") {
        rasterizer->forward(gaussians, cameras[view], scene, {}, render);
        stages.time("loss", [&] {
          loss = image_loss(render.color, targets[view].data(), loss_options, render_gradient.color);
        });
        if (fused) {
          rasterizer->backward_step(render_gradient, rates, adam, workload.parameters(), gradient);
        } else {
          rasterizer->backward(render_gradient, gradient);
        }
      } else {
        rasterizer->render(gaussians, cameras[view], scene, {}, render);
      }
      for (const raster::StageTime& stage : rasterizer->stage_times()) stages.add(stage.name, stage.milliseconds);
    }
    if (arguments.mode == "train" && !fused) {
      stages.time("adam", [&] { adam.step(gaussians, workload.parameters(), gradient, rates, arguments.threads); });
    }
    const double elapsed = std::chrono::duration<double, std::milli>(Clock::now() - begin).count();
    stages.end_step(step >= 0);
    if (step >= 0) milliseconds.push_back(elapsed);
  }

  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  nlohmann::json out = report(arguments, workload, milliseconds);
  out["peak_mib"] = static_cast<double>(usage.ru_maxrss) / 1024;
  out["stages"] = stages.medians();
  const Job job{.layout = model.layout(),
                .active_channels = arguments.active_channels,
                .fused = fused,
                .census = mean_census(model.view(), cameras, static_cast<std::size_t>(arguments.batch), kTileSide)};
  // As much as a step goes through: parameters and both moments.
  const std::size_t bytes = 3 * sizeof(float) * model.parameters.size();
  add_roofline(cpu_floors(job), measure_cpu_peaks(arguments.threads, bytes), job.census, out);
  out["mean_image"] = mean_image;
  out["loss"] = loss;
  return out;
}

}  // namespace splatbus::bench
