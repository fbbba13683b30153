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
constexpr std::size_t kBytesASample = 13 * sizeof(float) + sizeof(std::uint32_t);
constexpr std::size_t kRingSlack = 4096;  // tensors are aligned

std::vector<const InputView*> pointers(const std::vector<InputViewPointer>& views) {
  std::vector<const InputView*> plain;
  plain.reserve(views.size());
  for (const InputViewPointer& view : views) plain.push_back(view.get());
  return plain;
}

/// Whether a round makes another one, which waits, needless.
bool replaces(const InputJob& job, const InputJob& waiting) {
  return waiting.rig_generation == job.rig_generation && (waiting.glance || !job.glance);
}

}  // namespace

std::size_t sample_slot_bytes(std::size_t samples) {
  return samples * kBytesASample + kRingSlack;
}

std::vector<bus::TensorSource> sample_tensors(const RoundSamples& round) {
  using bus::ElementType;
  const auto n = static_cast<std::uint32_t>(round.size);
  std::vector<bus::TensorSource> sources{
      {"position", {n, 3}, ElementType::F32, round.position}, {"normal", {n, 3}, ElementType::F32, round.normal},
      {"albedo", {n, 3}, ElementType::F32, round.albedo},     {"color", {n, 3}, ElementType::F32, round.color},
      {"spacing", {n}, ElementType::F32, round.spacing_m},    {"object_id", {n}, ElementType::U32, round.object_id},
  };
  for (bus::TensorSource& source : sources) source.memory = round.memory;
  return sources;
}

const InputView& newest_of(const InputJob& job) {
  return **std::ranges::max_element(job.views, [](const auto& a, const auto& b) {
    return a->capture_ns != b->capture_ns ? a->capture_ns < b->capture_ns : a->frame < b->frame;
  });
}

void keep_one_size(InputJob& job) {
  const Camera camera = newest_of(job).camera;
  std::erase_if(job.views, [&](const InputViewPointer& view) {
    return view->camera.width != camera.width || view->camera.height != camera.height;
  });
}

InputWorker::InputWorker(const std::shared_ptr<bus::Context>& context, Device backend, const RoundSizes& expected)
    : sampler_(backend),
      publisher_(context),
      ring_(context, "input", kSampleSlots, sample_slot_bytes(expected.samples), backend),
      thread_([this](const std::stop_token& stop) { run(stop); }) {}

InputWorker::~InputWorker() {
  thread_.request_stop();
  wake_.notify_all();
}

void InputWorker::submit(InputJob job) {
  replace_by(job);
  {
    const std::scoped_lock lock(mutex_);
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

void InputWorker::replace_by(const InputJob& job) {
  const std::scoped_lock lock(mutex_);
  std::erase_if(jobs_, [&](const InputJob& waiting) { return replaces(job, waiting); });
}

std::optional<InputJob> InputWorker::take_waiting() {
  const std::scoped_lock lock(mutex_);
  if (!samples_ || jobs_.empty()) return std::nullopt;
  InputJob job = std::move(jobs_.front());
  jobs_.pop_front();
  return job;
}

void InputWorker::take_back(InputJob job) {
  {
    const std::scoped_lock lock(mutex_);
    if (std::ranges::any_of(jobs_, [&](const InputJob& waiting) { return replaces(waiting, job); })) return;
    jobs_.push_front(std::move(job));
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
      samples_ = false;
      if (!wake_.wait(lock, stop, [this] { return !jobs_.empty(); })) return;
      samples_ = true;
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
  const InputView& newest = newest_of(job);
  const bus::TracedWork work("sample round", newest.capture_ns, newest.scene_version);
  const auto start = std::chrono::steady_clock::now();
  const RoundSamples round = sampler_.sample(pointers(job.views), newest.objects, job.options);
  const std::chrono::duration<double, std::milli> took = std::chrono::steady_clock::now() - start;
  RoundResult result{.tensors = ring_.write(sample_tensors(round)),
                     .culled = round.culled,
                     .thinned = round.thinned,
                     .dropped = {},
                     .milliseconds = took.count()};
  for (const DropCounts& counts : round.dropped) result.dropped += counts;
  publish(job, result);
}

void InputWorker::publish(const InputJob& job, const RoundResult& result) {
  const InputView& newest = newest_of(job);
  const std::size_t samples = result.tensors.front().shape.front();
  const bus::MessageInfo info{.capture_ns = newest.capture_ns, .tensors = result.tensors};
  const std::scoped_lock in_order(publishing_);
  publisher_.publish(topics::kCaptureInput, info, [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
    std::vector<wire::Camera> cameras;
    cameras.reserve(job.views.size());
    for (const InputViewPointer& view : job.views) cameras.push_back(to_wire(view->camera));
    const auto cameras_offset = builder.CreateVectorOfStructs(cameras);
    const auto scene =
        to_wire(builder, SceneState{.light = newest.light, .objects = newest.objects, .version = newest.scene_version},
                newest.frame, newest.time_s);
    return wire::CreateCaptureInput(builder, header, job.rig_generation, cameras_offset, scene);
  });
  if (result.dropped.broken() > 0 && !std::exchange(complained_, true)) {
    spdlog::warn(
        "the engine's input pictures have pixels that were dropped: {} (said once; counted as samples_dropped)",
        result.dropped.text());
  }
  const std::scoped_lock lock(mutex_);
  ++statistics_.rounds;
  statistics_.samples = samples;
  statistics_.culled = result.culled;
  statistics_.thinned = result.thinned;
  statistics_.dropped += result.dropped.broken();
  statistics_.milliseconds = result.milliseconds;
  if (published_.size() >= kMaxPublished) published_.erase(published_.begin());
  // How much is new to a look ahead says nothing of its dome.
  published_.push_back({.rig_generation = job.glance ? 0 : job.rig_generation, .samples = samples});
}

}  // namespace splatbus::capture_bridge
