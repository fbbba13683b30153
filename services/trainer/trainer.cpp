#include "trainer/trainer.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <exception>
#include <filesystem>
#include <functional>
#include <limits>
#include <map>

#include "bus/clock.h"
#include "bus/frames.h"
#include "bus/log_sink.h"
#include "bus/memory.h"
#include "bus/trace.h"
#include "trainer/memory_failure.h"
#include "wire/capture_generated.h"
#include "wire/model_generated.h"

namespace splatbus::trainer {

namespace {

using namespace std::chrono_literals;

constexpr auto kReceiveTimeout = 50ms;
constexpr auto kPartPatience = 20s;
constexpr int kMaxDrained = 512;
constexpr auto kStopPeriod = 200ms;
constexpr std::uint64_t kMaxVisibilities = std::uint64_t{1} << 26;

/// What pictures may take: most of the memory is the model's.
std::size_t picture_bytes(Device memory) {
  return std::min(ViewStore::kMaxBytes, bus::free_memory(memory) / 4);
}

}  // namespace

Trainer::Trainer(bus::ServiceContext& service, StepMaker make_step)
    : service_(service),
      publisher_(service.bus),
      subscriber_(service.bus),
      views_(ViewStore::kMaxViews, picture_bytes(service.backend)),
      references_(service.backend, service.parameters.read<Options>().max_picture_pixels, views_.max_bytes(),
                  host_copied_bytes_),
      inserts_(service.backend, host_copied_bytes_),
      visibilities_(service.backend),
      make_step_(std::move(make_step)),
      sampler_(service.parameters.read<Options>().seed),
      options_(service.parameters) {}

void Trainer::run() {
  const Options& options = *options_;
  with_depth_ = wants_depth(options);
  views_.set_keeps(options.kept_view_interval > 0);
  subscribe();
  if (!stand_by()) return;
  // Where there is no broker yet, whoever makes a model waits for one and hears no signal meanwhile.
  while (!service_.bus->wait_connected(kStopPeriod)) {
    if (service_.stop.stop_requested()) return;
  }
  open_store();
  // Whatever they are called: two that publish a model each would have all others follow now one, now the other.
  service_.bus->claim_part("model", successor_ ? kPartPatience : 0ms);
  optimizer_ = std::make_unique<Optimizer>(*store_, options, make_step_);
  adopt_handover();
  pair_views();

  try {
    const std::jthread optimizer_thread([this](const std::stop_token& stop) { optimize(stop); });
    receive();
    commands_.wake();
  } catch (const MemoryFailure& failure) {
    throw std::runtime_error(failure.what());
  }
  if (optimizer_failure_) std::rethrow_exception(optimizer_failure_);
  if (service_.yields()) {
    hand_over();
  } else {
    leave_behind();
  }
}

void Trainer::open_store() {
  const Options& options = *options_;
  model::PageStoreOptions store{.max_gaussians = options.max_gaussians, .must_adopt = successor_};
  constexpr double kLeastActive = 0.25;
  const std::size_t most = WorldKeeper::most_pages(options.world, options.layout, service_.backend, kLeastActive);
  // A split takes its new pages before it gives the old one back.
  constexpr std::size_t kSplits = 64;
  if (most < std::numeric_limits<std::size_t>::max() - kSplits) store.max_pages = most + kSplits;
  store_ = std::make_unique<model::PageStore>(service_.bus, options.layout, store, service_.backend);
  spdlog::info("model: {}", store_->origin());
  WorldParameters world = options.world;
  world.max_gaussians = options.max_gaussians;
  const bool bounded = store.max_pages > 0 && service_.bus->address().is_local();
  if (world.folder.empty() && bounded) {
    world.folder = *service_.bus->address().directory + "/spilled-" + service_.bus->source();
    // Of another run on this bus, where the model that it belongs to is gone.
    std::error_code ignored;  // what stays is refused by name
    if (store_->count() == 0) std::filesystem::remove_all(world.folder, ignored);
  }
  if (!world.folder.empty()) keeper_ = std::make_unique<WorldKeeper>(*store_, world);
}

void Trainer::subscribe() {
  subscriber_
      .on(topics::kCaptureReference,
          [this](const wire::CaptureReference&, const bus::Message& message) { take_reference(message); })
      .on(topics::kModelInsert, [this](const wire::ModelInsert&, const bus::Message& message) { take_insert(message); })
      .on(topics::kRelightVisibility,
          [this](const wire::RelightVisibility& body, const bus::Message& message) { take_visibility(body, message); })
      .on(topics::kViewerPose,
          [this](const wire::ViewerPose& pose, const bus::Message&) { viewers_.take(pose, bus::now_ns()); });
}

void Trainer::receive() {
  while (!service_.stop.stop_requested() && !optimizer_failed_) {
    receive_once();
    service_.counter("lost_messages", static_cast<double>(subscriber_.lost()));
    service_.counter("lost_tensors", static_cast<double>(lost_tensors_));
    service_.counter("host_copied_bytes", static_cast<double>(host_copied_bytes_.load()));
  }
}

void Trainer::receive_once() {
  auto message = subscriber_.receive(kReceiveTimeout);
  // Pictures that are outdated by others in the queue are not copied.
  std::vector<bus::Message> references;
  for (int n = 0; message && n < kMaxDrained; ++n) {
    if (message->topic() == topics::kCaptureReference.name) {
      references.push_back(std::move(*message));
    } else {
      subscriber_.dispatch(*message);
    }
    message = subscriber_.receive(0ms);
  }
  if (message) subscriber_.dispatch(*message);
  take_references(references);
}

void Trainer::take_references(const std::vector<bus::Message>& messages) {
  std::map<ViewKey, const bus::Message*> newest;
  for (const auto& message : messages) {
    bus::guarded(message, [&] { newest[reference_key(message)] = &message; });
  }
  for (const auto& [key, message] : newest) {
    subscriber_.dispatch(*message);
  }
}

void Trainer::take_reference(const bus::Message& message) {
  const bus::TracedWork work("take reference", message.header().capture_ns());
  auto reading = references_.read(message, with_depth_);
  if (reading.retire) return views_.retire(reading.key);
  if (reading.lost) {
    ++lost_tensors_;
    return;
  }
  views_.put(reading.view);
  commands_.post([&](Commands& commands) { commands.look(std::move(reading.view)); });
}

void Trainer::take_insert(const bus::Message& message) {
  const bus::TracedWork work("take Gaussians", message.header().capture_ns());
  auto reading = inserts_.read(message);
  if (reading.lost) {
    ++lost_tensors_;
    return;
  }
  if (reading.batch.dropped > 0) {
    dropped_rows_ += reading.batch.dropped;
    service_.counter("dropped_rows", static_cast<double>(dropped_rows_));
    static bus::LogLimiter limiter;
    if (limiter.allow()) {
      spdlog::warn("model/insert from {}: {} of {} Gaussians in batch {} are not valid and were dropped",
                   bus::printable(message.header().source()->string_view()), reading.batch.dropped,
                   reading.batch.dropped + reading.batch.count, reading.batch.batch);
    }
  }
  bool taken = false;
  commands_.post([&](Commands& commands) { taken = commands.add(std::move(reading.batch)); });
  if (!taken) refuse(message);
}

void Trainer::refuse(const bus::Message& message) {
  if (refused_commands_++ == 0) {
    spdlog::warn("{} from {}: too much waits for the optimizer already; this is left out, and counted from now on",
                 message.topic(), message.header().source()->str());
  }
  service_.counter("refused_commands", static_cast<double>(refused_commands_));
}

void Trainer::take_visibility(const wire::RelightVisibility& relit, const bus::Message& message) {
  if (relit.count() > kMaxVisibilities) {
    throw bus::Error(message.topic() + ": a count of " + std::to_string(relit.count()) + " makes no sense");
  }
  std::vector<std::uint32_t> light_ids(relit.light_ids()->begin(), relit.light_ids()->end());
  const bool ascending = std::ranges::adjacent_find(light_ids, std::greater_equal()) == light_ids.end();
  if (light_ids.empty() || light_ids.size() > 1 + kMaxLightSources || light_ids.front() != 0 || !ascending) {
    throw bus::Error(message.topic() + ": its light_ids are not 0 and at most " + std::to_string(kMaxLightSources) +
                     " more, ascending");
  }
  constexpr std::uint32_t kMaxParts = 64;
  const auto is_shared_out = [&] {
    const bool pages_fit = relit.page_indices() == 1U << kPageShift &&
                           (relit.pages() == nullptr || std::is_sorted(relit.pages()->begin(), relit.pages()->end()));
    return relit.parts() <= kMaxParts && relit.part() < relit.parts() && pages_fit;
  };
  if (relit.parts() != 0 && !is_shared_out()) {
    throw bus::Error(message.topic() + ": its part, or the pages of it, make no sense");
  }
  if (relit.count() == 0) return;
  const auto tensor =
      message.tensor("visibility", bus::ElementType::U8,
                     {static_cast<std::uint32_t>(light_ids.size()), static_cast<std::uint32_t>(relit.count())});
  if (!tensor) {
    ++lost_tensors_;
    return;
  }
  const Device memory = service_.backend;
  const auto values = in_own_memory([&] {
    auto buffer = visibilities_.take(tensor->bytes());
    const bool whole = bus::copy_tensor(*tensor, buffer.get(), memory, host_copied_bytes_);
    return whole ? std::move(buffer) : nullptr;
  });
  if (!values) {
    ++lost_tensors_;
    return;
  }
  VisibilityCommand command{.model_generation = relit.model_generation(),
                            .scene_version = relit.scene_version(),
                            .count = relit.count(),
                            .light_ids = std::move(light_ids),
                            .visibility = values,
                            .parts = relit.parts(),
                            .part = relit.part(),
                            .division = relit.division(),
                            .pages = {}};
  if (relit.pages() != nullptr) command.pages.assign(relit.pages()->begin(), relit.pages()->end());
  commands_.post([&](Commands& commands) { commands.add(std::move(command)); });
}

}  // namespace splatbus::trainer
