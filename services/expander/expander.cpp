#include "expander/expander.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <utility>

#include "bus/clock.h"
#include "expander/parameters.h"
#include "expander/visibility.h"
#include "wire/convert.h"
#include "wire/model_generated.h"
#include "wire/published_model.h"
#include "wire/viewer_generated.h"

namespace splatbus::expander {

namespace {

constexpr std::size_t kWaitingRounds = 8;
constexpr std::int64_t kStatePeriodNs = 100'000'000;
constexpr std::int64_t kWaitingStatePeriodNs = 1'000'000'000;
constexpr int kMostMessagesAStep = 64;
// Published batches that are not acknowledged must stay readable: more slots than batches in flight.
constexpr std::size_t kBytesAGaussian = 18 * sizeof(float) + sizeof(std::uint32_t) + sizeof(CellId);
constexpr std::size_t kRingSlack = 4096;  // tensors are aligned
constexpr std::size_t kRingSlots = BatchLedger::Options{}.in_flight + 2;

/// Points of the model as it stands. False when its structure changed meanwhile.
bool read_points(const bus::Message& message, ModelPoints& points) {
  const auto model = PublishedModel::open(message);
  if (!model) return false;
  const GaussiansView& view = model->live();
  if (view.count > 0 && (view.cell == nullptr || view.object_id == nullptr || view.normal == nullptr)) return false;
  const float* position = view.surface_point != nullptr ? view.surface_point : view.plane(ParameterLayout::kMean);
  const auto vector_at = [&](const float* planes, std::size_t i) {
    return glm::vec3(planes[i], planes[view.stride + i], planes[2 * view.stride + i]);
  };
  for (std::size_t i = 0; i < view.count; ++i) {
    points.position.push_back(vector_at(position, i));
    points.normal.push_back(vector_at(view.normal, i));
    points.object_id.push_back(view.object_id[i]);
    points.cell.push_back(view.cell[i]);
  }
  return model->still_valid();
}

}  // namespace

Expander::Expander(std::shared_ptr<bus::Context> context, const bus::Parameters& parameters)
    : parameters_(parameters),
      context_(std::move(context)),
      subscriber_(context_, {"capture/input", "viewer/pose", "model/published"}),
      insert_publisher_(context_, "model/insert"),
      state_publisher_(context_, "grid/state"),
      ring_(context_, "insert", kRingSlots,
            static_cast<std::size_t>(parameters.integer("batch_size")) * kBytesAGaussian + kRingSlack),
      grid_(grid_options(parameters)),
      ledger_(ledger_options(parameters)),
      follower_(context_->epoch()) {}

void Expander::step(std::chrono::milliseconds timeout) {
  auto message = subscriber_.receive(timeout);
  for (int taken = 1; message; ++taken) {
    bus::guarded(*message, [&] { handle(*message); });
    if (taken >= kMostMessagesAStep) break;
    message = subscriber_.receive(std::chrono::milliseconds(0));
  }
  process_waiting();
  publish_batches();
  publish_state();
}

void Expander::handle(const bus::Message& message) {
  if (message.topic() == "capture/input") {
    handle_input(message);
  } else if (message.topic() == "model/published") {
    handle_published(message);
  } else {
    handle_pose(message);
  }
}

void Expander::handle_input(const bus::Message& message) {
  auto samples = decode_input(message);
  if (!samples) {
    ++counters_.rounds_lost;
    return;
  }
  if (samples->dropped > 0) {
    spdlog::warn("capture/input of rig generation {}: dropped {} samples that are not finite or make no sense",
                 samples->rig_generation, samples->dropped);
  }
  if (waiting_.empty()) waiting_since_ns_ = bus::now_ns();
  if (waiting_.size() >= kWaitingRounds) {
    ++counters_.rounds_lost;
    waiting_.pop_front();
  }
  waiting_.push_back(std::move(*samples));
}

void Expander::handle_pose(const bus::Message& message) {
  const auto& pose = message.root<wire::ViewerPose>("ViewerPose/1");
  viewer_ = from_wire(*pose.camera()).world_from_camera.translation;
}

void Expander::handle_published(const bus::Message& message) {
  const auto& published = message.root<wire::ModelPublished>("ModelPublished/1");
  ModelReport report{.trainer_epoch = message.header().epoch(),
                     .count = published.count(),
                     .insert_epoch = published.insert_epoch(),
                     .batches = {}};
  if (const auto* batches = published.inserted_batches()) report.batches.assign(batches->begin(), batches->end());
  const std::size_t pending = ledger_.pending();
  follower_.follow(
      report, [&](ModelPoints& points) { return read_points(message, points); }, grid_, ledger_);
  state_changed_ = state_changed_ || pending != ledger_.pending();
}

void Expander::process_waiting() {
  if (waiting_.empty()) return;
  const auto wait_ns = static_cast<std::int64_t>(parameters_.number("adopt_wait_s") * 1e9);
  if (!follower_.settled() && bus::now_ns() - waiting_since_ns_ < wait_ns) return;
  while (!waiting_.empty()) {
    process(waiting_.front());
    waiting_.pop_front();
  }
}

void Expander::process(const InputSamples& samples) {
  const std::int64_t start = bus::now_ns();
  ++counters_.rounds;
  counters_.samples += samples.size();
  counters_.samples_dropped += samples.dropped;
  state_changed_ = true;
  grid_.set_options(grid_options(parameters_));
  const auto seen = seen_samples(samples, visibility_options(parameters_));
  counters_.samples_unseen += static_cast<std::uint64_t>(std::count(seen.begin(), seen.end(), false));
  // Before a viewer is known, the rig stands about the place of interest.
  glm::vec3 middle(0);
  for (const Camera& camera : samples.cameras) middle += camera.world_from_camera.translation;
  if (!samples.cameras.empty()) middle /= static_cast<float>(samples.cameras.size());

  const auto limit = static_cast<std::size_t>(parameters_.integer("max_gaussians"));
  const std::size_t room = limit - std::min(limit, grid_.modelled_points());
  const std::vector<Chosen> chosen = grid_.choose(samples, seen, viewer_.value_or(middle), room);
  if (chosen.size() == room && gaussian_limit_logged_ != limit) {
    gaussian_limit_logged_ = limit;
    spdlog::warn("the model has reached max_gaussians = {}: nothing more is inserted", limit);
  }
  const auto batch_size = static_cast<std::size_t>(parameters_.integer("batch_size"));
  const std::span<const Chosen> all(chosen);
  for (std::size_t first = 0; first < all.size(); first += batch_size) {
    const auto part = all.subspan(first, std::min(batch_size, all.size() - first));
    ledger_.add(initial_gaussians(samples, part, initial_options(parameters_)));
  }
  counters_.milliseconds = static_cast<double>(bus::now_ns() - start) * 1e-6;
  spdlog::log(chosen.empty() ? spdlog::level::debug : spdlog::level::info,
              "input round of rig generation {}: {} of {} samples inserted", samples.rig_generation, chosen.size(),
              samples.size());
}

void Expander::publish_batches() {
  for (const InsertBatch* batch : ledger_.due(bus::now_ns())) publish(*batch);
}

void Expander::publish(const InsertBatch& batch) {
  using bus::ElementType;
  const auto n = static_cast<std::uint32_t>(batch.size());
  const std::vector<bus::TensorSource> sources{
      {"mean", {3, n}, ElementType::F32, batch.mean.data()},
      {"log_scale", {3, n}, ElementType::F32, batch.log_scale.data()},
      {"rotation", {4, n}, ElementType::F32, batch.rotation.data()},
      {"opacity_logit", {1, n}, ElementType::F32, batch.opacity_logit.data()},
      {"albedo", {3, n}, ElementType::F32, batch.albedo.data()},
      {"normal", {3, n}, ElementType::F32, batch.normal.data()},
      {"visibility", {1, n}, ElementType::F32, batch.visibility.data()},
      {"object_id", {n}, ElementType::U32, batch.object_id.data()},
      {"cell", {n}, ElementType::U64, batch.cell.data()},
  };
  const bus::MessageInfo info{
      .schema = "ModelInsert/1", .capture_ns = batch.capture_ns, .tensors = ring_.write(sources)};
  insert_publisher_.publish(info, [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
    const auto objects = to_wire(builder, batch.objects);
    const auto light = to_wire(builder, batch.light);
    return wire::CreateModelInsert(builder, header, batch.batch, objects, light);
  });
  ++counters_.batches_sent;
}

void Expander::publish_state() {
  const std::int64_t now = bus::now_ns();
  // Said again while no round has come: the capture-bridge then repeats the one that this process has missed.
  const bool waits = counters_.rounds == 0 && now - state_published_ns_ > kWaitingStatePeriodNs;
  if (!waits && (!state_changed_ || now - state_published_ns_ < kStatePeriodNs)) return;
  state_changed_ = false;
  state_published_ns_ = now;
  std::vector<wire::CellState> cells;
  cells.reserve(grid_.cells().size());
  for (const auto& [id, cell] : grid_.cells()) {
    cells.emplace_back(id, cell.samples, static_cast<std::uint32_t>(cell.points.size()), false);
  }
  state_publisher_.publish(
      {.schema = "GridState/1", .latch = true}, [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
        const auto cells_offset = builder.CreateVectorOfStructs(cells);
        return wire::CreateGridState(builder, header, grid_.options().cell_size_m, counters_.rounds, grid_.seen_cells(),
                                     grid_.modelled_cells(), ledger_.pending(), ledger_.gaussians(), cells_offset);
      });
}

void run(bus::ServiceContext& service) {
  Expander expander(service.bus, service.parameters);
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
    service.counter("cells", static_cast<double>(expander.grid().cells().size()));
    service.counter("adoptions", static_cast<double>(expander.follower().adoptions()));
    service.counter("round_ms", counters.milliseconds);
  }
}

}  // namespace splatbus::expander
