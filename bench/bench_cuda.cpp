#include <cuda_runtime.h>

#include <algorithm>
#include <numeric>

#include "bench/bench_scene.h"
#include "bench/roofline.h"
#include "raster/cuda/cuda_rasterizer.h"
#include "raster/cuda/device_model.h"
#include "raster/cuda/train_step.h"

namespace splatbus::bench {
namespace {

using raster::cuda::check;

/// Time between two points of a stream.
class Stopwatch {
 public:
  explicit Stopwatch(cudaStream_t stream) : stream_(stream) {
    check(cudaEventCreate(&begin_), "making an event");
    check(cudaEventCreate(&end_), "making an event");
  }
  ~Stopwatch() {
    cudaEventDestroy(begin_);
    cudaEventDestroy(end_);
  }
  Stopwatch(const Stopwatch&) = delete;
  Stopwatch& operator=(const Stopwatch&) = delete;

  void start() { check(cudaEventRecord(begin_, stream_), "timing"); }
  [[nodiscard]] double stop_ms() {
    float milliseconds = 0;
    check(cudaEventRecord(end_, stream_), "timing");
    check(cudaEventSynchronize(end_), "timing");
    check(cudaEventElapsedTime(&milliseconds, begin_, end_), "timing");
    return double{milliseconds};
  }

 private:
  cudaStream_t stream_;
  cudaEvent_t begin_ = nullptr, end_ = nullptr;
};

double free_mib() {
  std::size_t free_bytes = 0, total = 0;
  check(cudaMemGetInfo(&free_bytes, &total), "reading the free memory");
  return static_cast<double>(free_bytes) / (1024.0 * 1024.0);
}

/// What there is to do for the views of one group, with the model as it has become.
Census census_of(const raster::cuda::DeviceModel& model, const Workload& workload, std::size_t batch) {
  std::vector<float> parameters(static_cast<std::size_t>(workload.model.layout().channels()) * workload.model.count());
  model.download_parameters(parameters.data(), nullptr);
  check(cudaDeviceSynchronize(), "copying the model");
  GaussiansView trained = workload.model.view();
  trained.parameters = parameters.data();
  trained.stride = trained.count;
  std::vector<Camera> views;
  for (std::size_t k = 0; k < batch; ++k) views.push_back(workload.cameras[k % workload.cameras.size()]);
  return take_census(trained, views, raster::cuda::kTileSize);
}

std::uint32_t pairs_in_lists(const raster::cuda::TrainStep& trainer) {
  std::uint32_t pairs = 0;
  check(cudaStreamSynchronize(trainer.stream()), "timing the stages");
  check(cudaMemcpy(&pairs, trainer.workspace().pair_count, sizeof(pairs), cudaMemcpyDeviceToHost), "counting pairs");
  return pairs;
}

}  // namespace

/// Steps take the cameras in turn, a batch a step. A sample is one step where lists are built in every step; otherwise
/// the mean over one whole round of building them and using them again, for every batch.
nlohmann::json run_cuda(const Arguments& arguments) {
  Workload workload(arguments);
  const ParameterLayout layout = workload.model.layout();
  check(cudaFree(nullptr), "opening the device");
  const double free_before = free_mib();  // kernels that are loaded on their way count, too
  double mean_image = 0;
  std::vector<std::vector<std::uint8_t>> targets;
  {
    const auto rasterizer = raster::make_cuda_rasterizer();
    raster::Render render;
    for (const Camera& camera : workload.cameras) {
      rasterizer->render(workload.model.view(), camera, workload.scene, {}, render);
      if (targets.empty()) mean_image = mean_of(render.color);
      targets.push_back(to_target(render.color, workload.transfer()));
    }
  }
  const bool train = arguments.mode == "train";
  if (train) workload.disturb();

  raster::cuda::TrainStepOptions options;
  options.training = train;
  options.active_channels = arguments.active_channels;
  options.rebuild_interval = arguments.rebuild_interval;
  options.albedo_weight = arguments.albedo_weight;
  options.use_depth_limit = arguments.rebuild_interval > 1;
  options.project.pair_margin_px = arguments.rebuild_interval > 1 ? 0.5F : 0.0F;
  raster::cuda::DeviceModel model;
  model.upload(workload.model.view(), nullptr);
  std::vector<device::Buffer<std::uint8_t>> pictures(targets.size());
  for (std::size_t k = 0; k < targets.size() && train; ++k)
    pictures[k].upload(targets[k].data(), targets[k].size(), nullptr);
  check(cudaDeviceSynchronize(), "copying the workload");
  raster::cuda::TrainStep trainer(options);
  trainer.set_model(model.view());
  trainer.set_learning_rates(learning_rates(layout));
  const auto cameras = workload.cameras.size(), batch = static_cast<std::size_t>(arguments.batch);
  const std::size_t groups = std::lcm(cameras, batch) / batch;
  for (std::size_t group = 0; group < groups; ++group) {
    std::vector<raster::cuda::TrainView> views;
    for (std::size_t k = 0; k < batch; ++k) {
      const std::size_t camera = (group * batch + k) % cameras;
      const std::uint8_t* const picture = pictures[camera].data();
      views.push_back({{workload.cameras[camera], &workload.scene}, picture, picture});
    }
    trainer.add_group(views);
  }

  std::size_t group = 0;
  const auto step = [&] {
    train ? trainer.step(group) : trainer.forward(group);
    group = (group + 1) % groups;
  };
  const std::size_t steps = arguments.rebuild_interval == 1 ? 1 : groups * std::size_t(arguments.rebuild_interval);
  // Every group has sized its lists and captured its graphs before the first sample.
  const std::size_t warmup = std::max(static_cast<std::size_t>(arguments.warmup), 2 * groups);
  for (std::size_t k = 0; k < (warmup + steps - 1) / steps * steps; ++k) step();
  Stopwatch stopwatch(trainer.stream());
  std::vector<double> milliseconds;
  for (int k = 0; k < arguments.iterations; ++k) {
    stopwatch.start();
    for (std::size_t n = 0; n < steps; ++n) step();
    milliseconds.push_back(stopwatch.stop_ms() / static_cast<double>(steps));
  }
  const double used_mib = free_before - free_mib();

  nlohmann::json out = report(arguments, workload, milliseconds);
  out["rebuild_interval"] = arguments.rebuild_interval;
  out["peak_mib"] = used_mib;
  out["mean_image"] = mean_image;
  if (train) {
    const std::vector<float> losses = trainer.losses();
    out["loss"] = std::accumulate(losses.begin(), losses.end(), 0.0F);
  }
  for (const auto& [name, stage_ms] : trainer.time_stages(0, arguments.iterations)) out["stages"][name] = stage_ms;
  out["pairs_in_lists"] = pairs_in_lists(trainer);
  const Job job{.layout = layout,
                .active_channels = arguments.active_channels,
                .albedo = arguments.albedo_weight > 0,
                .census = census_of(model, workload, batch)};
  add_roofline(cuda_floors(job), measure_cuda_peaks(), job.census, out);
  return out;
}

}  // namespace splatbus::bench
