#include "expander/expander.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <utility>

#include "bus/clock.h"
#include "bus/error.h"
#include "bus/log_sink.h"
#include "bus/memory.h"
#include "bus/trace.h"
#include "model/published_model.h"
#include "wire/capture_generated.h"
#include "wire/convert.h"
#include "wire/model_generated.h"
#include "wire/viewer_generated.h"

namespace splatbus::expander {

namespace {

constexpr std::int64_t kStatePeriodNs = 100'000'000;
constexpr std::int64_t kSettledStatePeriodNs =
    10'000'000;  // all that was inserted is acknowledged: somebody waits for it
constexpr std::int64_t kWaitingStatePeriodNs = 200'000'000;
constexpr std::size_t kMaxCellsAMessage = 4096;
constexpr int kMaxMessagesAStep = 64;
constexpr std::chrono::seconds kSettlePatience{5};
constexpr std::size_t kMaxWaitingRounds = 8;
// Published batches that are not acknowledged must stay readable: more slots than batches in flight.
constexpr std::size_t kRingSlack = 4096;  // tensors are aligned
constexpr std::size_t kRingSlots = RetransmitQueue::Options{}.in_flight + 2;

/// As CellState names a cell.
std::uint64_t packed(const CellKey& key) {
  constexpr unsigned kBits = 21;
  constexpr std::int64_t kHalf = std::int64_t{1} << (kBits - 1);
  const CellCoordinates at = unpack_cell(key);
  return static_cast<std::uint64_t>(at.x + kHalf) << (2 * kBits) | static_cast<std::uint64_t>(at.y + kHalf) << kBits |
         static_cast<std::uint64_t>(at.z + kHalf);
}

}  // namespace

Expander::Expander(std::shared_ptr<bus::Context> context, const bus::Parameters& parameters, Device backend)
    : options_(parameters),
      context_(std::move(context)),
      inserter_(backend, options_->cell_size_m, options_->max_cells),
      subscriber_(context_),
      publisher_(context_),
      ring_(context_, "insert", kRingSlots, options_->insert.batch_size * kInsertBytes + kRingSlack,
            inserter_.memory()),
      queue_(options_->queue),
      model_sync_(context_->epoch()),
      cells_repeated_ns_(bus::now_ns()) {
  subscribe();
}

void Expander::subscribe() {
  subscriber_
      .on(topics::kCaptureInput,
          [this](const wire::CaptureInput&, const bus::Message& message) {
            auto incoming = open_round(message, options_->max_samples);
            if (!incoming) {
              ++counters_.rounds_lost;
              return;
            }
            incoming_.push_back(std::move(*incoming));
          })
      .on(topics::kViewerPose,
          [this](const wire::ViewerPose& pose, const bus::Message& message) {
            viewpoints_.take(pose, message.header().publish_ns(), bus::now_ns());
          })
      .on(topics::kTrainerStats,
          [this](const wire::TrainerStats& stats, const bus::Message&) { steps_per_s_ = stats.steps_per_s(); })
      .on(topics::kModelPublished, [this](const wire::ModelPublished& published, const bus::Message& message) {
        handle_published(published, message);
      });
}

void Expander::handle_published(const wire::ModelPublished& published, const bus::Message& message) {
  Report report{.report = {.trainer_epoch = message.header().epoch(),
                           .generation = published.generation(),
                           .count = published.count(),
                           .insert_epoch = published.insert_epoch(),
                           .batches = {}},
                .message = message};
  if (const auto* batches = published.inserted_batches())
    report.report.batches.assign(batches->begin(), batches->end());
  reports_.push_back(std::move(report));
}

void Expander::step(std::chrono::milliseconds timeout) {
  if (options_.refresh()) queue_.set_resend(options_->queue.resend_ns);
  receive(timeout);
  follow_model();
  take_rounds();
  insert_rounds();
  publish_batches();
  publish_state();
}

bool Expander::settle(std::chrono::milliseconds timeout) {
  receive(timeout);
  incoming_.clear();
  waiting_.clear();  // the capture-bridge repeats the newest for who comes next
  follow_model();
  publish_batches();
  publish_state();
  return queue_.pending() > 0;
}

void Expander::receive(std::chrono::milliseconds timeout) {
  auto message = subscriber_.receive(timeout);
  for (int taken = 1; message; ++taken) {
    prepare_ring();
    if (!subscriber_.dispatch(*message) && message->topic() == topics::kCaptureInput.name) ++counters_.rounds_lost;
    if (taken >= kMaxMessagesAStep) break;
    message = subscriber_.receive(std::chrono::milliseconds(0));
  }
}

void Expander::follow_model() {
  for (; !reports_.empty(); reports_.pop_front()) {
    Report& next = reports_.front();
    model_ = std::move(next.message);
    const std::size_t pending = queue_.pending();
    const std::uint64_t changes = model_sync_.adoptions() + model_sync_.restarts();
    model_sync_.follow(
        next.report, [this] { return adopt_model(); }, inserter_, queue_);
    const bool replaced = changes != model_sync_.adoptions() + model_sync_.restarts();
    state_changed_ = state_changed_ || replaced || pending != queue_.pending();
  }
}

bool Expander::adopt_model() try {
  auto model =
      PublishedModel::open(*model_, inserter_.memory(), PublishedModel::Need::Average, opened_ ? &*opened_ : nullptr);
  if (!model || !inserter_.adopt(*model, model_->header().epoch())) return false;
  opened_ = std::move(model);
  model_read_ns_ = bus::now_ns();
  state_changed_ = true;
  return true;
} catch (const bus::Error& error) {
  bus::require_usable(inserter_.memory());
  static bus::LogLimiter limiter;
  if (limiter.allow()) spdlog::warn("model/published is refused: {}", error.what());
  return false;
}

void Expander::take_rounds() {
  for (; !incoming_.empty(); incoming_.pop_front()) {
    auto round = inserter_.take(incoming_.front());
    if (!round) {
      ++counters_.rounds_lost;
      continue;
    }
    static bus::LogLimiter limiter;
    if (round->invalid > 0 && limiter.allow()) {
      spdlog::warn("capture/input of rig generation {}: dropped {} samples that are not finite or make no sense",
                   round->rig_generation, round->invalid);
    }
    if (waiting_.size() >= kMaxWaitingRounds) {
      waiting_.pop_front();
      ++counters_.rounds_lost;
    }
    waiting_.push_back({.round = std::move(round), .arrived_ns = bus::now_ns()});
  }
}

void Expander::insert_rounds() {
  if (waiting_.empty()) return;
  const std::int64_t now = bus::now_ns();
  const auto wait_ns = static_cast<std::int64_t>(options_->adopt_wait_s * 1e9);
  if (!model_sync_.settled() && now - waiting_.front().arrived_ns < wait_ns) return;
  if (model_ && now - model_read_ns_ >= static_cast<std::int64_t>(options_->refresh_s * 1e9)) {
    (void)model_sync_.refresh([this] { return adopt_model(); }, inserter_, queue_);
  }
  for (; !waiting_.empty(); waiting_.pop_front()) {
    insert(*waiting_.front().round);
    publish_batches();
  }
}

void Expander::insert(const Round& round) {
  const bus::TracedWork work("insert round", round.capture_ns);
  const std::int64_t start = bus::now_ns();
  const std::size_t limit = options_->max_gaussians;
  InsertOptions options = options_->insert_at(steps_per_s_);
  options.select.room = static_cast<std::uint32_t>(limit - std::min(limit, inserter_.modelled().size()));
  InsertResult result =
      inserter_.insert(round, viewpoints_.at(bus::now_ns(), options_->ahead_s, round.cameras), options);
  ++counters_.rounds;
  counters_.samples += round.samples.count - round.invalid;
  counters_.samples_invalid += round.invalid;
  counters_.samples_beyond += result.beyond;
  counters_.inserted_bare += result.reasons.bare;
  counters_.inserted_hole += result.reasons.hole;
  counters_.inserted_fill += result.reasons.fill;
  if (result.beyond > 0 && !std::exchange(beyond_logged_, true)) {
    spdlog::warn("{} samples lie too far from the origin of their frame for cells of {} m: they are not modelled",
                 result.beyond, options_->cell_size_m);
  }
  state_changed_ = true;
  if (result.selected == options.select.room && gaussian_limit_logged_ != limit) {
    gaussian_limit_logged_ = limit;
    spdlog::warn("the model has reached max_gaussians = {}: nothing more is inserted", limit);
  }
  if (!result.batches.empty() && unsent_since_ns_ == 0) unsent_since_ns_ = round.publish_ns;
  for (InsertBatch& batch : result.batches) queue_.add(std::move(batch));
  counters_.milliseconds = static_cast<double>(bus::now_ns() - start) * 1e-6;
  spdlog::log(
      result.selected == 0 ? spdlog::level::debug : spdlog::level::info,
      "input round of rig generation {}: {} of {} samples inserted ({} on new ground, {} in holes, {} to fill), "
      "{:.1f} ms",
      round.rig_generation, result.selected, round.samples.count, result.reasons.bare, result.reasons.hole,
      result.reasons.fill, counters_.milliseconds);
}

void Expander::publish_batches() {
  for (const InsertBatch* batch : queue_.due(bus::now_ns())) publish(*batch);
  if (unsent_since_ns_ == 0 || !queue_.all_sent()) return;
  counters_.latency_milliseconds = static_cast<double>(bus::now_ns() - unsent_since_ns_) * 1e-6;
  unsent_since_ns_ = 0;
}

void Expander::publish(const InsertBatch& batch) {
  using bus::ElementType;
  const std::uint32_t n = batch.count;
  const InsertChannels channels = batch.channels();
  const auto source = [&](const char* name, std::vector<std::uint32_t> shape, ElementType type, const void* data) {
    return bus::TensorSource{
        .name = name, .shape = std::move(shape), .type = type, .data = data, .memory = batch.memory};
  };
  const std::vector<bus::TensorSource> sources{
      source("mean", {3, n}, ElementType::F32, channels.mean),
      source("log_scale", {3, n}, ElementType::F32, channels.log_scale),
      source("rotation", {4, n}, ElementType::F32, channels.rotation),
      source("opacity_logit", {1, n}, ElementType::F32, channels.opacity_logit),
      source("albedo", {3, n}, ElementType::F32, channels.albedo),
      source("normal", {3, n}, ElementType::F32, channels.normal),
      source("visibility", {1, n}, ElementType::F32, channels.visibility),
      source("object_id", {n}, ElementType::U32, channels.object_id),
  };
  const bus::MessageInfo info{.capture_ns = batch.capture_ns, .tensors = ring_.write(sources)};
  publisher_.publish(topics::kModelInsert, info, [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
    const auto objects = to_wire(builder, batch.scene.objects);
    const auto light = to_wire(builder, batch.scene.light);
    return wire::CreateModelInsert(builder, header, batch.batch, objects, light);
  });
  ++counters_.batches_sent;
}

void Expander::publish_state() {
  const std::int64_t now = bus::now_ns();
  const std::int64_t since = now - state_published_ns_;
  // Said again while no round has come: the capture-bridge then repeats the one that this process has missed.
  const bool waits = counters_.rounds == 0 && waiting_.empty() && since > kWaitingStatePeriodNs;
  const bool due = since >= (queue_.pending() == 0 ? kSettledStatePeriodNs : kStatePeriodNs);
  CellTable& table = inserter_.cells();
  const bool repeats =
      table.size() > 0 && now - cells_repeated_ns_ >= static_cast<std::int64_t>(options_->repeat_s * 1e9);
  if (!waits && !(due && (state_changed_ || table.changed())) && !repeats) return;
  if (table.full() && !std::exchange(cell_limit_logged_, true)) {
    spdlog::warn("grid/state tells of max_cells = {} cells: further ones are left out", options_->max_cells);
  }
  if (repeats) cells_repeated_ns_ = now;
  std::vector<wire::CellState> cells;
  for (const CellReport& cell : table.take(kMaxCellsAMessage, repeats ? kMaxCellsAMessage : 0)) {
    cells.emplace_back(packed(cell.key), cell.key.object_id, cell.samples, cell.modelled);
  }
  publisher_.publish(topics::kGridState, [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
    const auto cells_offset = builder.CreateVectorOfStructs(cells);
    return wire::CreateGridState(builder, header, options_->cell_size_m, counters_.rounds, table.seen(),
                                 table.modelled(), queue_.pending(), queue_.gaussians(), cells_offset);
  });
  state_changed_ = false;
  state_published_ns_ = now;
}

void Expander::prepare_ring() {
  // The slab is made while nothing waits for it: a message has come, so the broker is there.
  if (!std::exchange(ring_prepared_, true)) (void)ring_.write({});
}

void run(bus::ServiceContext& service) {
  Expander expander(service.bus, service.parameters, service.backend);
  expander.adopt_handover();
  while (!service.stop.stop_requested()) {
    expander.step(std::chrono::milliseconds(20));
    const ExpanderCounters& counters = expander.counters();
    const bool waits = !expander.model_sync().settled();
    service.detail(waits ? "waiting for the trainer's model/published" : "");
    service.counter("rounds", static_cast<double>(counters.rounds));
    service.counter("rounds_lost", static_cast<double>(counters.rounds_lost));
    service.counter("samples", static_cast<double>(counters.samples));
    service.counter("samples_invalid", static_cast<double>(counters.samples_invalid));
    service.counter("samples_beyond", static_cast<double>(counters.samples_beyond));
    service.counter("batches_sent", static_cast<double>(counters.batches_sent));
    service.counter("batches_pending", static_cast<double>(expander.queue().pending()));
    service.counter("gaussians_inserted", static_cast<double>(expander.queue().gaussians()));
    service.counter("inserted_bare", static_cast<double>(counters.inserted_bare));
    service.counter("inserted_hole", static_cast<double>(counters.inserted_hole));
    service.counter("inserted_fill", static_cast<double>(counters.inserted_fill));
    service.counter("cells", static_cast<double>(expander.inserter().cells().size()));
    service.counter("adoptions", static_cast<double>(expander.model_sync().adoptions()));
    service.counter("round_ms", counters.milliseconds);
    service.counter("latency_ms", counters.latency_milliseconds);
    service.counter("host_copied_bytes", static_cast<double>(expander.inserter().host_copied_bytes()));
  }
  // Whoever comes next reads the model, and would insert again what is not in it yet.
  const auto deadline = std::chrono::steady_clock::now() + kSettlePatience;
  while (service.yields() && expander.settle(std::chrono::milliseconds(20)) &&
         std::chrono::steady_clock::now() < deadline) {
  }
  expander.leave_behind();
}

}  // namespace splatbus::expander
