#include "capture-bridge/round_message.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "bus/error.h"
#include "bus/memory.h"
#include "wire/convert.h"

namespace splatbus::capture_bridge {

namespace {

constexpr std::uint64_t kMaxBudget = 4'000'000;  // of sample_budget
constexpr std::size_t kMaxMoments = kMaxViews + 1;

std::string tensor_name(std::size_t view) {
  return fmt::format("view-{}", view);
}

/// Where objects were, each state once: most views of a round share one.
class Moments {
 public:
  std::uint32_t index(const ObjectTransforms& objects) {
    const auto found = std::ranges::find_if(all_, [&](const auto* one) { return *one == objects; });
    if (found != all_.end()) return static_cast<std::uint32_t>(found - all_.begin());
    all_.push_back(&objects);
    return static_cast<std::uint32_t>(all_.size() - 1);
  }
  [[nodiscard]] const std::vector<const ObjectTransforms*>& all() const { return all_; }

 private:
  std::vector<const ObjectTransforms*> all_;
};

SamplingOptions read_options(const wire::RoundOptions& said) {
  const SamplingOptions options{.min_cosine = said.min_cosine(),
                                .culling = {.similar = said.similar(),
                                            .min_normal_cosine = said.min_normal_cosine(),
                                            .edge_penalty = said.edge_penalty()},
                                .budget = said.budget(),
                                .cameras_per_surface = static_cast<int>(said.cameras_per_surface())};
  const bool finite = std::isfinite(options.min_cosine) && std::isfinite(options.culling.similar) &&
                      std::isfinite(options.culling.min_normal_cosine) && std::isfinite(options.culling.edge_penalty);
  if (!finite || said.budget() > kMaxBudget || said.cameras_per_surface() > kMaxViews) {
    throw bus::Error("sampling/round: options that nobody can set");
  }
  return options;
}

}  // namespace

std::vector<bus::TensorSource> round_tensors(const InputJob& job) {
  std::vector<bus::TensorSource> sources;
  sources.reserve(job.views.size());
  for (const InputViewPointer& view : job.views) {
    sources.push_back({.name = tensor_name(sources.size()),
                       .shape = {static_cast<std::uint32_t>(input_view_bytes(view->pixels()))},
                       .type = bus::ElementType::U8,
                       .data = view->pictures(),
                       .memory = view->memory});
  }
  return sources;
}

flatbuffers::Offset<wire::SamplingRound> write_round(flatbuffers::FlatBufferBuilder& builder,
                                                     flatbuffers::Offset<wire::Header> header, const std::string& to,
                                                     std::uint64_t job_id, const InputJob& job) {
  Moments moments;
  const std::uint32_t moment = moments.index(newest_of(job).objects);
  std::vector<flatbuffers::Offset<wire::RoundView>> views;
  views.reserve(job.views.size());
  for (const InputViewPointer& view : job.views) {
    const wire::Camera camera = to_wire(view->camera);
    const wire::Vec3 background = to_wire(view->light.background);
    views.push_back(wire::CreateRoundView(builder, &camera, &background, moments.index(view->objects)));
  }
  std::vector<flatbuffers::Offset<wire::RoundMoment>> states;
  for (const ObjectTransforms* objects : moments.all()) {
    states.push_back(wire::CreateRoundMoment(builder, to_wire(builder, *objects)));
  }
  const SamplingOptions& o = job.options;
  const wire::RoundOptions options(o.budget, static_cast<std::uint32_t>(o.cameras_per_surface), o.min_cosine,
                                   o.culling.similar, o.culling.min_normal_cosine, o.culling.edge_penalty);
  return wire::CreateSamplingRound(builder, header, builder.CreateString(to), job_id, builder.CreateVector(views),
                                   builder.CreateVector(states), moment, &options);
}

std::optional<ForeignRound> read_round(const wire::SamplingRound& round, const bus::Message& message,
                                       bus::MemoryPool& pool, std::atomic<std::uint64_t>& host_bytes) {
  const std::size_t count = round.views()->size(), states = round.moments()->size();
  if (count == 0 || count > kMaxViews || states > kMaxMoments || round.moment() >= states) {
    throw bus::Error(fmt::format("sampling/round: {} views, and objects of {} instants", count, states));
  }
  std::vector<ObjectTransforms> moments;
  for (const wire::RoundMoment* moment : *round.moments()) moments.push_back(from_wire(moment->objects()));
  ForeignRound read{
      .job = round.job(), .views = {}, .objects = moments[round.moment()], .options = read_options(*round.options())};
  for (const wire::RoundView* said : *round.views()) {
    InputView view;
    view.camera = from_wire(*said->camera());
    view.light.background = from_wire(*said->background(), "background");
    if (said->moment() >= states) throw bus::Error("sampling/round: a view of an unknown instant");
    view.objects = moments[said->moment()];
    const Camera& first = read.views.empty() ? view.camera : read.views.front().camera;
    if (view.camera.width != first.width || view.camera.height != first.height) {
      throw bus::Error("sampling/round: views of several sizes");
    }
    const auto bytes = static_cast<std::uint32_t>(input_view_bytes(view.pixels()));
    const auto pictures = message.tensor(tensor_name(read.views.size()), bus::ElementType::U8, {bytes});
    if (!pictures) return std::nullopt;
    // Only now: that the tensor is there bounds the size.
    view.allocate(pool);
    if (!view.take_pictures(*pictures, host_bytes)) return std::nullopt;
    read.views.push_back(std::move(view));
  }
  return read;
}

}  // namespace splatbus::capture_bridge
