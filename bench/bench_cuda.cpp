#include <cuda_runtime.h>

#include <algorithm>
#include <numeric>

#include "bench/bench_scene.h"
#include "bench/roofline.h"
#include "raster/cuda/cuda_model_renderer.h"
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

/// What there is to do for the views of one batch, with the model as it has become.
Census census_of(const raster::cuda::DeviceModel& model, const Workload& workload, std::size_t batch) {
  std::vector<Camera> views;
  for (std::size_t k = 0; k < batch; ++k) views.push_back(workload.cameras[k % workload.cameras.size()]);
  // Parameters in pages come back in pages: they are counted as they were.
  if (model.view().has_pages()) return take_census(workload.model.view(), views, raster::cuda::kTileSize);
  std::vector<float> parameters(static_cast<std::size_t>(workload.model.layout().channels()) * workload.model.count());
  model.download_parameters(parameters.data(), nullptr);
  check(cudaDeviceSynchronize(), "copying the model");
  GaussiansView trained = workload.model.view();
  trained.parameters = parameters.data();
  trained.stride = trained.count;
  return take_census(trained, views, raster::cuda::kTileSize);
}

std::uint32_t isects_of(const raster::cuda::TrainStep& trainer) {
  std::uint32_t isects = 0;
  check(cudaStreamSynchronize(trainer.stream()), "timing the stages");
  check(cudaMemcpy(&isects, &trainer.workspace().counts->isects, sizeof(isects), cudaMemcpyDeviceToHost),
        "counting intersections");
  return isects;
}

/// Of the pages, in the last launch.
double listed_share(const raster::cuda::TrainStep& trainer, const raster::cuda::DeviceGaussians& gaussians) {
  std::uint32_t listed = 0;
  check(cudaMemcpy(&listed, &trainer.workspace().counts->listed, sizeof(listed), cudaMemcpyDeviceToHost),
        "counting pages");
  return static_cast<double>(listed) / gaussians.range_count;
}

}  // namespace

/// Steps take the cameras in turn, a batch a step; a sample is one step.
nlohmann::json run_cuda(const Arguments& arguments) {
  Workload workload(arguments);
  const ParameterLayout layout = workload.model.layout();
  check(cudaFree(nullptr), "opening the device");
  const double free_before = free_mib();
  double mean_image = 0;
  std::vector<std::vector<std::uint8_t>> targets;
  {
    const auto renderer = raster::cuda::make_cuda_model_renderer();
    renderer->take(workload.view());
    raster::Render render;
    for (const Camera& camera : workload.cameras) {
      renderer->draw(camera, workload.scene, {}, render);
      if (targets.empty()) mean_image = mean_of(render.color);
      targets.push_back(to_target(render.color, workload.transfer()));
    }
  }
  const bool train = arguments.mode == "train";
  if (train) workload.disturb();

  raster::cuda::TrainStepOptions options;
  options.training = train;
  options.active_channels = arguments.active_channels;
  options.albedo_weight = arguments.albedo_weight;
  raster::cuda::DeviceModel model;
  model.upload(workload.view(), nullptr);
  std::vector<device::Buffer<std::uint8_t>> pictures(targets.size());
  for (std::size_t k = 0; k < targets.size() && train; ++k)
    pictures[k].upload(targets[k].data(), targets[k].size(), nullptr);
  check(cudaDeviceSynchronize(), "copying the workload");
  raster::cuda::TrainStep trainer(options);
  trainer.set_model(model.view());
  trainer.set_learning_rates(learning_rates(layout));
  const auto cameras = workload.cameras.size(), batch = static_cast<std::size_t>(arguments.batch);
  std::vector<std::vector<raster::cuda::TrainView>> batches(std::lcm(cameras, batch) / batch);
  for (std::size_t k = 0; k < batches.size() * batch; ++k) {
    const std::size_t camera = k % cameras;
    const std::uint8_t* const picture = pictures[camera].data();
    const raster::cuda::DeviceGaussians& rows = model.view();
    batches[k / batch].push_back(
        {{workload.cameras[camera], &workload.scene, rows.visibility_u8, rows.visibility_stride, rows.visibility_rows},
         picture,
         picture});
  }

  std::size_t next = 0;
  const auto step = [&] {
    train ? trainer.step(batches[next]) : trainer.forward(batches[next]);
    next = (next + 1) % batches.size();
  };
  // There is room for every batch, and the step has become a graph, before the first sample.
  const std::size_t warmup = std::max(static_cast<std::size_t>(arguments.warmup), 2 * batches.size());
  for (std::size_t k = 0; k < warmup; ++k) step();
  Stopwatch stopwatch(trainer.stream());
  std::vector<double> milliseconds;
  for (int k = 0; k < arguments.iterations; ++k) {
    stopwatch.start();
    step();
    milliseconds.push_back(stopwatch.stop_ms());
  }
  const double used_mib = free_before - free_mib();

  nlohmann::json out = report(arguments, workload, milliseconds);
  out["peak_mib"] = used_mib;
  out["mean_image"] = mean_image;
  if (train) {
    const std::vector<float> losses = trainer.losses();
    out["loss"] = std::accumulate(losses.begin(), losses.end(), 0.0F);
  }
  for (const auto& [name, stage_ms] : trainer.time_stages(batches[0], arguments.iterations))
    out["stages"][name] = stage_ms;
  out["isects"] = isects_of(trainer);
  if (model.view().has_pages()) out["pages_listed"] = listed_share(trainer, model.view());
  const Job job{.layout = layout,
                .active_channels = arguments.active_channels,
                .albedo = arguments.albedo_weight > 0,
                .census = census_of(model, workload, batch)};
  add_roofline(cuda_floors(job), measure_cuda_peaks(), job.census, out);
  return out;
}

}  // namespace splatbus::bench
