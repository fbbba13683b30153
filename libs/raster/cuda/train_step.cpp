#include "raster/cuda/train_step.h"

#include <algorithm>
#include <array>
#include <functional>
#include <stdexcept>

#include "raster/cuda/device_buffer.h"

namespace splatbus::raster::cuda {
namespace {

constexpr std::uint32_t kFirstPairCapacity = 1U << 20U;

class Graph {
 public:
  Graph() = default;
  ~Graph() { reset(); }
  Graph(const Graph&) = delete;
  Graph& operator=(const Graph&) = delete;

  void reset() {
    if (executable_ != nullptr) cudaGraphExecDestroy(executable_);
    executable_ = nullptr;
  }
  void launch(cudaStream_t stream, const std::function<void()>& enqueue) {
    if (executable_ == nullptr) {
      cudaGraph_t graph = nullptr;
      check(cudaStreamBeginCapture(stream, cudaStreamCaptureModeThreadLocal), "capturing a step");
      enqueue();
      check(cudaStreamEndCapture(stream, &graph), "capturing a step");
      const cudaError_t status = cudaGraphInstantiate(&executable_, graph, 0);
      cudaGraphDestroy(graph);
      check(status, "making a step's graph");
    }
    check(cudaGraphLaunch(executable_, stream), "launching a step");
  }

 private:
  cudaGraphExec_t executable_ = nullptr;
};

/// Views that are trained together, and their tile lists.
struct Group {
  std::vector<TrainView> views;
  int width = 0, height = 0;
  DeviceBuffer<DeviceView> device_views;
  DeviceBuffer<ObjectView> object_views;
  DeviceBuffer<const std::uint8_t*> color_targets, albedo_targets;
  DeviceBuffer<uint2> tile_range;
  DeviceBuffer<float> tile_depth_limit;
  DeviceBuffer<std::uint32_t> records;
  int steps = 0;  // since the lists were built
  bool lists_built = false;
  Graph rebuild_graph, reuse_graph;
};

}  // namespace

struct TrainStep::Impl {
  explicit Impl(TrainStepOptions o) : options(o) {
    check(cudaStreamCreateWithFlags(&stream, cudaStreamNonBlocking), "creating a stream");
    check(cudaMallocHost(reinterpret_cast<void**>(&host_pair_count), sizeof(std::uint32_t)),
          "allocating pinned memory");
    *host_pair_count = 0;
  }
  ~Impl() {
    cudaStreamSynchronize(stream);
    groups.clear();
    cudaFreeHost(host_pair_count);
    cudaStreamDestroy(stream);
  }

  TrainStepOptions options;
  cudaStream_t stream = nullptr;
  DeviceGaussians gaussians;
  std::vector<std::uint32_t> host_object_id;
  std::vector<std::uint32_t> object_ids;  // of the slots in object_slot
  DeviceBuffer<std::uint16_t> object_slot;
  DeviceBuffer<float> first, second, learning_rate;
  DeviceBuffer<std::uint32_t> steps;
  std::vector<std::unique_ptr<Group>> groups;
  Workspace workspace;
  std::uint32_t pair_capacity = kFirstPairCapacity;
  std::uint32_t* host_pair_count = nullptr;
  const Group* last = nullptr;

  [[nodiscard]] bool albedo() const {
    return options.albedo_weight > 0.0F && gaussians.layout.appearance == Appearance::Transfer;
  }

  WorkspaceView workspace_for(const Group& group) {
    WorkspaceRequest request{.count = gaussians.count,
                             .batch = static_cast<int>(group.views.size()),
                             .width = group.width,
                             .height = group.height,
                             .object_count = 1,
                             .albedo = albedo(),
                             .training = true,
                             .pair_capacity = pair_capacity};
    if (workspace.reserve(request)) {
      for (auto& other : groups) {
        other->rebuild_graph.reset();
        other->reuse_graph.reset();
      }
    }
    WorkspaceView w = workspace.view();
    w.views = group.device_views.data();
    w.object_views = group.object_views.data();
    w.object_count = static_cast<int>(group.object_views.size() / group.views.size());
    w.object_slot = object_ids.empty() ? nullptr : object_slot.data();
    w.tile_range = group.tile_range.data();
    w.tile_depth_limit = group.tile_depth_limit.data();
    w.pair_records[1] = group.records.data();
    return w;
  }

  [[nodiscard]] ProjectOptions project_options(bool rebuild) const {
    ProjectOptions project = options.project;
    project.emit_pairs = rebuild;
    project.use_depth_limit = options.use_depth_limit;
    return project;
  }

  void build_lists(const WorkspaceView& w) {
    launch_sort(w, stream);
    check(cudaMemcpyAsync(host_pair_count, w.pair_count, sizeof(std::uint32_t), cudaMemcpyDeviceToHost, stream),
          "reading the pair count");
  }

  void picture_loss(const float* rendered, const Group& group, bool of_albedo, float* gradient,
                    const WorkspaceView& w) {
    const LossKernelOptions loss{
        .ssim_weight = options.ssim_weight,
        .weight = (of_albedo ? options.albedo_weight : 1.0F) / static_cast<float>(group.views.size()),
        .encode_srgb = gaussians.layout.appearance == Appearance::Transfer};
    launch_loss(rendered, of_albedo ? group.albedo_targets.data() : group.color_targets.data(), gradient, w, loss,
                stream);
  }

  void losses(const Group& group, const WorkspaceView& w) {
    check(cudaMemsetAsync(w.loss, 0, sizeof(float) * kMaxBatch, stream), "clearing the losses");
    picture_loss(w.color, group, false, w.color_gradient, w);
    if (albedo()) picture_loss(w.albedo, group, true, w.albedo_gradient, w);
  }

  void update(const WorkspaceView& w) {
    const AdamOptions adam{.beta1 = options.beta1,
                           .beta2 = options.beta2,
                           .epsilon = options.epsilon,
                           .learning_rate = learning_rate.data(),
                           .active_channels = options.active_channels};
    const OptimizerState state{.first = first.data(), .second = second.data(), .steps = steps.data()};
    launch_update(gaussians, w, project_options(false), state, adam, stream);
  }

  void enqueue_forward(const WorkspaceView& w, bool rebuild) {
    launch_project(gaussians, w, project_options(rebuild), stream);
    if (rebuild) build_lists(w);
    launch_blend_forward(gaussians, w, stream);
  }

  /// Grows the pair buffers when an earlier build did not fit. The count is of a build long done, or not there yet.
  void grow_if_needed(Group& group) {
    if (*host_pair_count > pair_capacity) {
      check(cudaStreamSynchronize(stream), "waiting to grow");
      pair_capacity = *host_pair_count + *host_pair_count / 4;
      for (auto& other : groups) other->lists_built = false;
    }
    if (group.records.size() < pair_capacity) {
      check(cudaStreamSynchronize(stream), "waiting to grow");
      group.records.resize(pair_capacity);
      group.rebuild_graph.reset();
      group.reuse_graph.reset();
      group.lists_built = false;
    }
  }

  bool wants_rebuild(const Group& group) const {
    return !group.lists_built || group.steps >= std::max(1, options.rebuild_interval);
  }

  void run(Group& group, bool train) {
    grow_if_needed(group);
    const bool rebuild = wants_rebuild(group);
    // A group's first build is sized before anything depends on it: the only wait.
    const bool first_build = !group.lists_built;
    const WorkspaceView w = workspace_for(group);
    const auto enqueue = [&] {
      enqueue_forward(w, rebuild);
      if (!train) return;
      losses(group, w);
      launch_blend_backward(gaussians, w, stream);
      update(w);
    };
    if (first_build) {
      launch_project(gaussians, w, project_options(true), stream);
      check(cudaMemcpyAsync(host_pair_count, w.pair_count, sizeof(std::uint32_t), cudaMemcpyDeviceToHost, stream),
            "reading the pair count");
      check(cudaStreamSynchronize(stream), "sizing the tile lists");
      if (*host_pair_count > pair_capacity || *host_pair_count < pair_capacity / 4) {
        pair_capacity = *host_pair_count + *host_pair_count / 4 + 1024;
        if (group.records.size() < pair_capacity || workspace.view().pair_capacity < pair_capacity) {
          group.lists_built = true;  // sized: not again
          group.steps = options.rebuild_interval;
          run(group, train);
          return;
        }
      }
      group.lists_built = true;
    }
    if (!options.use_graph || !train) {
      enqueue();
    } else {
      (rebuild ? group.rebuild_graph : group.reuse_graph).launch(stream, enqueue);
    }
    group.steps = rebuild ? 1 : group.steps + 1;
    last = &group;
  }
};

TrainStep::TrainStep(TrainStepOptions options) : impl_(std::make_unique<Impl>(options)) {}
TrainStep::~TrainStep() = default;

void TrainStep::set_model(const DeviceGaussians& gaussians, const std::uint32_t* host_object_id, bool keep_moments) {
  check(cudaStreamSynchronize(impl_->stream), "changing the model");
  clear_groups();
  const auto elements =
      static_cast<std::size_t>(gaussians.layout.channels()) * static_cast<std::size_t>(gaussians.stride);
  const bool same = impl_->first.size() == elements && impl_->gaussians.layout == gaussians.layout &&
                    impl_->gaussians.stride == gaussians.stride;
  impl_->gaussians = gaussians;
  impl_->host_object_id.clear();
  if (host_object_id != nullptr) impl_->host_object_id.assign(host_object_id, host_object_id + gaussians.count);
  impl_->first.resize(elements);
  impl_->second.resize(elements);
  impl_->steps.resize(static_cast<std::size_t>(gaussians.stride));
  if (!(keep_moments && same)) {
    impl_->first.clear(impl_->stream);
    impl_->second.clear(impl_->stream);
    impl_->steps.clear(impl_->stream);
  }
}

void TrainStep::set_learning_rates(const std::vector<float>& rates) {
  if (rates.size() != static_cast<std::size_t>(impl_->gaussians.layout.channels())) {
    throw std::invalid_argument("TrainStep: one learning rate a channel is needed");
  }
  impl_->learning_rate.upload(rates.data(), rates.size(), impl_->stream);
  check(cudaStreamSynchronize(impl_->stream), "copying the learning rates");
}

std::size_t TrainStep::add_group(std::span<const TrainView> views) {
  if (views.empty() || views.size() > static_cast<std::size_t>(kMaxBatch)) {
    throw std::invalid_argument("TrainStep: a group has 1 to " + std::to_string(kMaxBatch) + " views");
  }
  auto group = std::make_unique<Group>();
  group->views.assign(views.begin(), views.end());
  group->width = static_cast<int>(views[0].view.camera.width);
  group->height = static_cast<int>(views[0].view.camera.height);
  std::vector<SceneView> scenes;
  std::vector<const std::uint8_t*> colors, albedos;
  for (const TrainView& view : views) {
    if (static_cast<int>(view.view.camera.width) != group->width ||
        static_cast<int>(view.view.camera.height) != group->height) {
      throw std::invalid_argument("TrainStep: all views of a group have one size");
    }
    scenes.push_back(view.view);
    colors.push_back(view.color);
    albedos.push_back(view.albedo);
  }
  const ViewTables tables = make_view_tables(scenes, impl_->gaussians.layout.appearance);
  if (tables.object_ids != impl_->object_ids && !tables.object_ids.empty()) {
    impl_->object_ids = tables.object_ids;
    const auto slots = object_slots(impl_->host_object_id.empty() ? nullptr : impl_->host_object_id.data(),
                                    static_cast<std::size_t>(impl_->gaussians.count), tables.object_ids);
    impl_->object_slot.upload(slots.data(), slots.size(), impl_->stream);
    check(cudaStreamSynchronize(impl_->stream), "copying object slots");
  }
  group->device_views.upload(tables.views.data(), tables.views.size(), impl_->stream);
  group->object_views.upload(tables.object_views.data(), tables.object_views.size(), impl_->stream);
  group->color_targets.upload(colors.data(), colors.size(), impl_->stream);
  group->albedo_targets.upload(albedos.data(), albedos.size(), impl_->stream);
  const auto tiles = static_cast<std::size_t>((group->width + kTileSize - 1) / kTileSize) *
                     static_cast<std::size_t>((group->height + kTileSize - 1) / kTileSize) * views.size();
  group->tile_range.resize(tiles);
  group->tile_depth_limit.resize(tiles);
  // Nothing is known to be hidden before the first blend: all ones is a NaN, which no depth lies beyond.
  check(cudaMemsetAsync(group->tile_depth_limit.data(), 0xFF, sizeof(float) * tiles, impl_->stream),
        "setting depth limits");
  check(cudaStreamSynchronize(impl_->stream), "copying a group");
  impl_->groups.push_back(std::move(group));
  return impl_->groups.size() - 1;
}

void TrainStep::clear_groups() {
  check(cudaStreamSynchronize(impl_->stream), "dropping groups");
  impl_->groups.clear();
  impl_->object_ids.clear();
  impl_->last = nullptr;
}

void TrainStep::step(std::size_t group) {
  impl_->run(*impl_->groups.at(group), true);
}
void TrainStep::forward(std::size_t group) {
  impl_->run(*impl_->groups.at(group), false);
}

std::vector<float> TrainStep::losses() {
  if (impl_->last == nullptr) return {};
  std::vector<float> host(impl_->last->views.size());
  check(cudaMemcpyAsync(host.data(), impl_->workspace.view().loss, sizeof(float) * host.size(), cudaMemcpyDeviceToHost,
                        impl_->stream),
        "reading losses");
  check(cudaStreamSynchronize(impl_->stream), "reading losses");
  return host;
}

const float* TrainStep::color() const {
  return impl_->workspace.view().color;
}
cudaStream_t TrainStep::stream() const {
  return impl_->stream;
}

std::size_t TrainStep::bytes() const {
  std::size_t total = impl_->workspace.bytes() + (impl_->first.size() + impl_->second.size() + impl_->steps.size()) * 4;
  for (const auto& group : impl_->groups) total += group->records.size() * 4 + group->tile_range.size() * 12;
  return total;
}

std::vector<TrainStep::StageTime> TrainStep::time_stages(std::size_t index, int repeats) {
  Group& group = *impl_->groups.at(index);
  impl_->run(group, true);
  const WorkspaceView w = impl_->workspace_for(group);
  Impl& impl = *impl_;
  const std::array<std::pair<const char*, std::function<void()>>, 7> stages = {{
      {"project+emit", [&] { launch_project(impl.gaussians, w, impl.project_options(true), impl.stream); }},
      {"sort", [&] { launch_sort(w, impl.stream); }},
      {"project", [&] { launch_project(impl.gaussians, w, impl.project_options(false), impl.stream); }},
      {"blend forward", [&] { launch_blend_forward(impl.gaussians, w, impl.stream); }},
      {"loss", [&] { impl.losses(group, w); }},
      {"blend backward", [&] { launch_blend_backward(impl.gaussians, w, impl.stream); }},
      {"update", [&] { impl.update(w); }},
  }};
  std::vector<StageTime> times;
  cudaEvent_t begin = nullptr, end = nullptr;
  check(cudaEventCreate(&begin), "making an event");
  check(cudaEventCreate(&end), "making an event");
  for (const auto& [name, run] : stages) {
    std::vector<float> samples;
    for (int k = 0; k < repeats; ++k) {
      check(cudaEventRecord(begin, impl.stream), "timing");
      run();
      check(cudaEventRecord(end, impl.stream), "timing");
      check(cudaEventSynchronize(end), "timing");
      float milliseconds = 0.0F;
      check(cudaEventElapsedTime(&milliseconds, begin, end), "timing");
      samples.push_back(milliseconds);
    }
    std::nth_element(samples.begin(), samples.begin() + repeats / 2, samples.end());
    times.push_back({name, samples[static_cast<std::size_t>(repeats) / 2]});
  }
  cudaEventDestroy(begin);
  cudaEventDestroy(end);
  return times;
}

}  // namespace splatbus::raster::cuda
