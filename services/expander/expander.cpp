#include "expander/expander.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <utility>

#include "bus/clock.h"
#include "bus/memory.h"
#include "wire/capture_generated.h"
#include "wire/convert.h"
#include "wire/model_generated.h"
#include "wire/published_model.h"
#include "wire/viewer_generated.h"

namespace splatbus::expander {

namespace {

constexpr std::int64_t kStatePeriodNs = 100'000'000;
constexpr std::int64_t kSettledStatePeriodNs =
    10'000'000;  // all that was inserted is acknowledged: somebody waits for it
constexpr std::int64_t kWaitingStatePeriodNs = 200'000'000;
constexpr int kMostMessagesAStep = 64;
// Published batches that are not acknowledged must stay readable: more slots than batches in flight.
constexpr std::size_t kRingSlack = 4096;  // tensors are aligned
constexpr std::size_t kRingSlots = BatchLedger::Options{}.in_flight + 2;

}  // namespace

Expander::Expander(std::shared_ptr<bus::Context> context, const bus::Parameters& parameters, Device backend)
    : options_(parameters),
      context_(std::move(context)),
      mapper_(make_mapper(backend, options_->mapper)),
      subscriber_(context_),
      publisher_(context_),
      ring_(context_, "insert", kRingSlots, options_->grow.batch_size * kInsertBytes + kRingSlack, mapper_->memory()),
      ledger_(options_->ledger),
      follower_(context_->epoch()) {
  subscribe();
}

void Expander::subscribe() {
  subscriber_
      .on(topics::kCaptureInput,
          [this](const wire::CaptureInput&, const bus::Message& message) { handle_input(message); })
      .on(topics::kViewerPose, [this](const wire::ViewerPose& pose, const bus::Message&) { handle_pose(pose); })
      .on(topics::kModelPublished, [this](const wire::ModelPublished& published, const bus::Message& message) {
        handle_published(published, message);
      });
}

void Expander::step(std::chrono::milliseconds timeout) {
  options_.refresh();
  mapper_->limit_device_memory(options_->device_bytes);
  auto message = subscriber_.receive(timeout);
  for (int taken = 1; message; ++taken) {
    prepare_ring();
    if (!subscriber_.dispatch(*message)) {
      bus::require_usable(mapper_->memory());
      if (message->topic() == topics::kCaptureInput.name) ++counters_.rounds_lost;
    }
    if (taken >= kMostMessagesAStep) break;
    message = subscriber_.receive(std::chrono::milliseconds(0));
  }
  process_waiting();
  publish_batches();
  publish_state();
}

void Expander::handle_input(const bus::Message& message) {
  auto incoming = open_round(message);
  if (!incoming || !waiting_.add(std::move(*incoming), bus::now_ns())) ++counters_.rounds_lost;
}

void Expander::handle_pose(const wire::ViewerPose& pose) {
  viewer_ = from_wire(*pose.camera()).world_from_camera.translation;
}

void Expander::handle_published(const wire::ModelPublished& published, const bus::Message& message) {
  ModelReport report{.trainer_epoch = message.header().epoch(),
                     .count = published.count(),
                     .insert_epoch = published.insert_epoch(),
                     .batches = {}};
  if (const auto* batches = published.inserted_batches()) report.batches.assign(batches->begin(), batches->end());
  const std::size_t pending = ledger_.pending();
  const auto adopt_model = [&] {
    const auto model = PublishedModel::open(message, mapper_->memory(), PublishedModel::Need::Average);
    return model && mapper_->adopt(*model);
  };
  follower_.follow(report, adopt_model, *mapper_, ledger_);
  state_changed_ = state_changed_ || pending != ledger_.pending();
}

void Expander::process_waiting() {
  if (waiting_.empty()) return;
  const std::int64_t now = bus::now_ns();
  const auto wait_ns = static_cast<std::int64_t>(options_->adopt_wait_s * 1e9);
  const bool grows = follower_.settled() || now - waiting_.since_ns() >= wait_ns;
  WaitingRounds::Work work{
      .take = [&](const IncomingRound& incoming) { return take(incoming); },
      .grow = {},
      .failed =
          [&](const RoundInfo& info, const std::exception& error, bool again) {
            live_through(fmt::format("input round of rig generation {}: {}; it is {}", info.rig_generation,
                                     error.what(), again ? "tried again" : "set aside"));
          }};
  if (grows) {
    work.grow = [&](const Round& round) {
      grow(round);
      publish_batches();
    };
  }
  counters_.rounds_lost += waiting_.run(work, now, retry_ns());
}

std::unique_ptr<Round> Expander::take(const IncomingRound& incoming) {
  auto round = mapper_->take(incoming);
  if (round && round->dropped() > 0) {
    spdlog::warn("capture/input of rig generation {}: dropped {} samples that are not finite or make no sense",
                 incoming.rig_generation, round->dropped());
  }
  return round;
}

void Expander::grow(const Round& round) {
  const std::int64_t start = bus::now_ns();
  const RoundInfo& info = round.info();
  // Before a viewer is known, the rig stands about the place of interest.
  glm::vec3 middle(0);
  for (const Camera& camera : info.cameras) middle += camera.world_from_camera.translation;
  if (!info.cameras.empty()) middle /= static_cast<float>(info.cameras.size());

  const std::size_t limit = options_->max_gaussians;
  const std::size_t room = limit - std::min(limit, mapper_->modelled_points());
  GrowOptions options = options_->grow;
  options.viewer = viewer_.value_or(middle);
  options.room = room;
  Growth growth = mapper_->grow(round, options);
  ++counters_.rounds;
  counters_.samples += round.size();
  counters_.samples_dropped += round.dropped();
  counters_.samples_unseen += growth.unseen;
  state_changed_ = true;
  if (growth.chosen == room && gaussian_limit_logged_ != limit) {
    gaussian_limit_logged_ = limit;
    spdlog::warn("the model has reached max_gaussians = {}: nothing more is inserted", limit);
  }
  if (!growth.batches.empty() && unsent_since_ns_ == 0) unsent_since_ns_ = info.publish_ns;
  for (InsertBatch& batch : growth.batches) ledger_.add(std::move(batch));
  counters_.milliseconds = static_cast<double>(bus::now_ns() - start) * 1e-6;
  spdlog::log(growth.chosen == 0 ? spdlog::level::debug : spdlog::level::info,
              "input round of rig generation {}: {} of {} samples inserted, {:.1f} ms", info.rig_generation,
              growth.chosen, round.size(), counters_.milliseconds);
}

void Expander::publish_batches() {
  for (const InsertBatch* batch : ledger_.due(bus::now_ns())) {
    // One that fails counts as published: it is repeated, like all that nobody acknowledges.
    if (!attempt("publishing a batch", [&] { publish(*batch); })) break;
  }
  if (unsent_since_ns_ == 0 || !ledger_.all_sent()) return;
  counters_.latency_milliseconds = static_cast<double>(bus::now_ns() - unsent_since_ns_) * 1e-6;
  unsent_since_ns_ = 0;
}

void Expander::publish(const InsertBatch& batch) {
  using bus::ElementType;
  const auto n = static_cast<std::uint32_t>(batch.size());
  const InsertPlanes planes = batch.planes();
  const auto source = [&](const char* name, std::vector<std::uint32_t> shape, ElementType type, const void* data) {
    return bus::TensorSource{
        .name = name, .shape = std::move(shape), .type = type, .data = data, .memory = batch.memory};
  };
  const std::vector<bus::TensorSource> sources{
      source("mean", {3, n}, ElementType::F32, planes.mean),
      source("log_scale", {3, n}, ElementType::F32, planes.log_scale),
      source("rotation", {4, n}, ElementType::F32, planes.rotation),
      source("opacity_logit", {1, n}, ElementType::F32, planes.opacity_logit),
      source("albedo", {3, n}, ElementType::F32, planes.albedo),
      source("normal", {3, n}, ElementType::F32, planes.normal),
      source("visibility", {1, n}, ElementType::F32, planes.visibility),
      source("object_id", {n}, ElementType::U32, planes.object_id),
      source("cell", {n}, ElementType::U64, planes.cell),
  };
  const bus::MessageInfo info{.capture_ns = batch.capture_ns, .tensors = ring_.write(sources)};
  publisher_.publish(topics::kModelInsert, info, [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
    const auto objects = to_wire(builder, batch.objects);
    const auto light = to_wire(builder, batch.light);
    return wire::CreateModelInsert(builder, header, batch.batch, objects, light);
  });
  ++counters_.batches_sent;
}

void Expander::publish_state() {
  const std::int64_t now = bus::now_ns();
  const std::int64_t since = now - state_published_ns_;
  // Said again while no round has come: the capture-bridge then repeats the one that this process has missed.
  const bool waits = counters_.rounds == 0 && waiting_.empty() && since > kWaitingStatePeriodNs;
  const bool due = since >= (ledger_.pending() == 0 ? kSettledStatePeriodNs : kStatePeriodNs);
  if (!waits && !(state_changed_ && due)) return;
  if (now < state_retry_ns_) return;
  if (!attempt("publishing grid/state", [&] { send_state(); })) {
    state_retry_ns_ = now + retry_ns();
    return;
  }
  state_changed_ = false;
  state_published_ns_ = now;
}

void Expander::send_state() {
  std::vector<wire::CellState> cells;
  std::uint64_t seen = 0, modelled = 0;
  for (const CellCounts& cell : mapper_->cells()) {
    cells.emplace_back(cell.cell, cell.samples, cell.points);
    seen += cell.samples > 0 ? 1 : 0;
    modelled += cell.points > 0 ? 1 : 0;
  }
  counters_.cells = cells.size();
  publisher_.publish(topics::kGridState, [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
    const auto cells_offset = builder.CreateVectorOfStructs(cells);
    return wire::CreateGridState(builder, header, options_->mapper.cell_size_m, counters_.rounds, seen, modelled,
                                 ledger_.pending(), ledger_.gaussians(), cells_offset);
  });
}

void Expander::prepare_ring() {
  // The slab is made while nothing waits for it: a message has come, so the broker is there.
  if (std::exchange(ring_prepared_, true)) return;
  attempt("making the slab of inserts", [&] { (void)ring_.write({}); });
}

std::int64_t Expander::retry_ns() const {
  return static_cast<std::int64_t>(options_->retry_s * 1e9);
}

bool Expander::attempt(const char* what, const std::function<void()>& part) try {
  part();
  return true;
} catch (const std::exception& error) {
  live_through(fmt::format("{}: {}; it is tried again", what, error.what()));
  return false;
}

void Expander::live_through(const std::string& failure) {
  spdlog::error("{}", failure);
  ++counters_.failures;
  bus::require_usable(mapper_->memory());
}

void run(bus::ServiceContext& service) {
  Expander expander(service.bus, service.parameters, service.backend);
  while (!service.stop.stop_requested()) {
    expander.step(std::chrono::milliseconds(20));
    const ExpanderCounters& counters = expander.counters();
    const bool waits = !expander.follower().settled();
    service.detail(waits ? "waiting for the trainer's model/published" : "");
    service.counter("rounds", static_cast<double>(counters.rounds));
    service.counter("rounds_lost", static_cast<double>(counters.rounds_lost));
    service.counter("samples", static_cast<double>(counters.samples));
    service.counter("samples_dropped", static_cast<double>(counters.samples_dropped));
    service.counter("samples_unseen", static_cast<double>(counters.samples_unseen));
    service.counter("batches_sent", static_cast<double>(counters.batches_sent));
    service.counter("batches_pending", static_cast<double>(expander.ledger().pending()));
    service.counter("gaussians_inserted", static_cast<double>(expander.ledger().gaussians()));
    service.counter("cells", static_cast<double>(counters.cells));
    service.counter("failures", static_cast<double>(counters.failures));
    service.counter("adoptions", static_cast<double>(expander.follower().adoptions()));
    service.counter("round_ms", counters.milliseconds);
    service.counter("latency_ms", counters.latency_milliseconds);
    service.counter("host_copied_bytes", static_cast<double>(expander.mapper().host_copied_bytes()));
  }
}

}  // namespace splatbus::expander
