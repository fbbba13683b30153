#include "capture-bridge/input_worker.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <chrono>
#include <exception>
#include <utility>

#include "bus/log_sink.h"
#include "bus/trace.h"
#include "wire/capture_generated.h"
#include "wire/convert.h"

namespace splatbus::capture_bridge {

namespace {

constexpr std::size_t kMaxPublished = 64;
constexpr std::size_t kRingSlots = 4;
constexpr std::size_t kBytesASample = 13 * sizeof(float) + sizeof(std::uint32_t);
constexpr std::size_t kRingSlack = 4096;  // tensors are aligned

std::vector<const InputView*> pointers(const std::vector<InputViewPointer>& views) {
  std::vector<const InputView*> plain;
  plain.reserve(views.size());
  for (const InputViewPointer& view : views) plain.push_back(view.get());
  return plain;
}

/// Views are of one size unless the size was changed while a rig was captured; then the newest size counts.
std::vector<InputViewPointer> of_one_size(const std::vector<InputViewPointer>& views, const Camera& camera) {
  std::vector<InputViewPointer> same;
  std::copy_if(views.begin(), views.end(), std::back_inserter(same), [&](const InputViewPointer& view) {
    return view->camera.width == camera.width && view->camera.height == camera.height;
  });
  return same;
}

}  // namespace

InputPublisher::InputPublisher(const std::shared_ptr<bus::Context>& context, Device kind, const RoundSizes& expected)
    : publisher_(context), ring_(context, "input", kRingSlots, expected.samples * kBytesASample + kRingSlack, kind) {}

void InputPublisher::publish(std::span<const InputViewPointer> views, const InputView& newest,
                             std::uint64_t rig_generation, const RoundSamples& round) {
  using bus::ElementType;
  const auto n = static_cast<std::uint32_t>(round.size);
  std::vector<bus::TensorSource> sources{
      {"position", {n, 3}, ElementType::F32, round.position}, {"normal", {n, 3}, ElementType::F32, round.normal},
      {"albedo", {n, 3}, ElementType::F32, round.albedo},     {"color", {n, 3}, ElementType::F32, round.color},
      {"spacing", {n}, ElementType::F32, round.spacing_m},    {"object_id", {n}, ElementType::U32, round.object_id},
  };
  for (bus::TensorSource& source : sources) source.memory = round.memory;
  const bus::MessageInfo info{.capture_ns = newest.capture_ns, .tensors = ring_.write(sources)};
  publisher_.publish(topics::kCaptureInput, info, [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
    std::vector<wire::Camera> cameras;
    cameras.reserve(views.size());
    for (const InputViewPointer& view : views) cameras.push_back(to_wire(view->camera));
    const auto cameras_offset = builder.CreateVectorOfStructs(cameras);
    const auto scene =
        to_wire(builder, SceneState{.light = newest.light, .objects = newest.objects, .version = newest.scene_version},
                newest.frame, newest.time_s);
    return wire::CreateCaptureInput(builder, header, rig_generation, cameras_offset, scene);
  });
}

InputWorker::InputWorker(const std::shared_ptr<bus::Context>& context, Device backend, const RoundSizes& expected)
    : sampler_(backend),
      publisher_(context, backend, expected),
      thread_([this](const std::stop_token& stop) { run(stop); }) {}

InputWorker::~InputWorker() {
  thread_.request_stop();
  wake_.notify_all();
}

void InputWorker::submit(InputJob job) {
  if (job.views.empty()) return;
  {
    const std::scoped_lock lock(mutex_);
    std::erase_if(jobs_, [&](const InputJob& waiting) {
      return waiting.rig_generation == job.rig_generation && (waiting.glance || !job.glance);
    });
    if (jobs_.size() >= kMaxQueued) {
      static bus::LogLimiter limiter;
      if (limiter.allow()) {
        spdlog::warn("input round of rig generation {} dropped: sampling is behind", jobs_.front().rig_generation);
      }
      jobs_.pop_front();
    }
    jobs_.push_back(std::move(job));
  }
  wake_.notify_all();
}

std::vector<PublishedRound> InputWorker::take_published() {
  const std::scoped_lock lock(mutex_);
  return std::exchange(published_, {});
}

InputStatistics InputWorker::statistics() const {
  const std::scoped_lock lock(mutex_);
  return statistics_;
}

void InputWorker::run(const std::stop_token& stop) {
  while (true) {
    InputJob job;
    {
      std::unique_lock lock(mutex_);
      if (!wake_.wait(lock, stop, [this] { return !jobs_.empty(); })) return;
      job = std::move(jobs_.front());
      jobs_.pop_front();
    }
    try {
      process(job);
    } catch (const std::exception& error) {
      static bus::LogLimiter limiter;
      if (limiter.allow()) spdlog::error("input round of rig generation {}: {}", job.rig_generation, error.what());
      failed_ = true;
    }
  }
}

void InputWorker::process(const InputJob& job) {
  const auto& newest = **std::max_element(job.views.begin(), job.views.end(), [](const auto& a, const auto& b) {
    return a->capture_ns != b->capture_ns ? a->capture_ns < b->capture_ns : a->frame < b->frame;
  });
  const bus::TracedWork work("sample round", newest.capture_ns, newest.scene_version);
  const auto views = of_one_size(job.views, newest.camera);
  const auto start = std::chrono::steady_clock::now();
  const RoundSamples round = sampler_.sample(pointers(views), newest.objects, job.options);
  const std::chrono::duration<double, std::milli> took = std::chrono::steady_clock::now() - start;
  publisher_.publish(views, newest, job.rig_generation, round);

  DropCounts dropped;
  for (const DropCounts& counts : round.dropped) dropped += counts;
  if (dropped.broken() > 0 && !complained_) {
    complained_ = true;
    spdlog::warn(
        "the engine's input pictures have pixels that were dropped: {} (said once; counted as samples_dropped)",
        dropped.text());
  }
  const std::scoped_lock lock(mutex_);
  ++statistics_.rounds;
  statistics_.samples = round.size;
  statistics_.culled = round.culled;
  statistics_.thinned = round.thinned;
  statistics_.dropped += dropped.broken();
  statistics_.milliseconds = took.count();
  if (published_.size() >= kMaxPublished) published_.erase(published_.begin());
  // How much is new to a look ahead says nothing of its dome.
  published_.push_back({.rig_generation = job.glance ? 0 : job.rig_generation, .samples = round.size});
}

}  // namespace splatbus::capture_bridge
