#include "capture-bridge/sampler.h"

#include <fmt/format.h>

#include <algorithm>
#include <cassert>
#include <cmath>
#include <stdexcept>

#include "capture-bridge/stages.h"
#include "gaussians/portable.h"

namespace splatbus::capture_bridge {

namespace {

constexpr std::size_t kMaxPixels = std::size_t{1} << 30;

PixelView pixel_view(const InputView& view, bool far_field) {
  const Camera& camera = view.camera;
  const Mat3 world_from_camera = portable(camera.world_from_camera.rotation);
  PixelView pixels{.width = camera.width,
                   .height = camera.height,
                   .fx = camera.fx,
                   .fy = camera.fy,
                   .cx = camera.cx,
                   .cy = camera.cy,
                   .near_m = camera.near_m,
                   .far_m = camera.far_m,
                   .centre = portable(camera.world_from_camera.translation),
                   .world_from_camera = world_from_camera,
                   .camera_from_world = transposed(world_from_camera),
                   .background = portable(view.light.background),
                   .position = reinterpret_cast<const float*>(view.position.data()),
                   .normal = reinterpret_cast<const float*>(view.normal.data()),
                   .object_id = view.object_id.data(),
                   .color = reinterpret_cast<const std::uint8_t*>(view.color.data()),
                   .albedo = reinterpret_cast<const std::uint8_t*>(view.albedo.data()),
                   .far_field = far_field};
  for (int c = 0; c < 3; ++c) {
    pixels.background_rgb8[c] = static_cast<std::uint8_t>(
        std::lround(255 * std::clamp(srgb_from_linear(view.light.background[c]), 0.0F, 1.0F)));
  }
  return pixels;
}

/// Appends the objects of a view that stand elsewhere in the round's frame, or whose pixels are no samples, by
/// ascending id. Gone is what the round does not have any more, what was no object yet as the view was taken, and what
/// is not to be modelled.
void add_moved(const ObjectTransforms& view_objects, const ObjectTransforms& round_objects,
               std::vector<MovedObject>& moved) {
  auto then = view_objects.begin();
  auto now = round_objects.begin();
  while (then != view_objects.end() || now != round_objects.end()) {
    const bool of_view = now == round_objects.end() || (then != view_objects.end() && then->first <= now->first);
    const bool of_round = then == view_objects.end() || (now != round_objects.end() && now->first <= then->first);
    if (of_view && of_round && now->second.modelled && then->second.modelled) {
      if (now->second.rigid != then->second.rigid || now->second.scale != then->second.scale) {
        const math::Similarity round_from_view = portable(now->second) * inverse(portable(then->second));
        moved.push_back(
            {.id = now->first, .round_from_view = round_from_view, .view_from_round = inverse(round_from_view)});
      }
    } else {
      moved.push_back(
          {.id = of_view ? then->first : now->first, .gone = true, .round_from_view = {}, .view_from_round = {}});
    }
    if (of_view) ++then;
    if (of_round) ++now;
  }
}

/// Samples of the ranks up to the most cameras a surface that the budget has room for.
int cameras_within_budget(std::span<const std::uint32_t, kRanks> of_rank, std::size_t budget) {
  const std::size_t most = budget + budget / 8;
  int cameras = 1;
  std::size_t samples = of_rank[1];
  for (std::size_t rank = 2; rank < kRanks && of_rank[rank] > 0; ++rank) {
    samples += of_rank[rank];
    if (samples > most) break;
    ++cameras;
  }
  return cameras;
}

/// By how much the distance between samples grows when `kept` of `survived` are kept: the mean area that one stands for
/// has grown by what thinning took away.
float spacing_growth(std::size_t survived, std::size_t kept) {
  return kept == 0 ? 1.0F : std::sqrt(static_cast<float>(survived) / static_cast<float>(kept));
}

LinearTable linear_table() {
  LinearTable table{};
  for (std::size_t i = 0; i < 256; ++i) table.value[i] = linear_from_srgb(static_cast<float>(i) / 255.0F);
  return table;
}

}  // namespace

DropCounts& DropCounts::operator+=(const DropCounts& other) {
  not_finite += other.not_finite;
  bad_normal += other.bad_normal;
  off_ray += other.off_ray;
  return *this;
}

DropCounts dropped_of(std::span<const std::uint32_t, kFaults> faults) {
  const auto of = [&](PixelFault fault) { return std::size_t{faults[static_cast<std::size_t>(fault)]}; };
  return {.not_finite = of(PixelFault::NotFinite),
          .bad_normal = of(PixelFault::BadNormal),
          .off_ray = of(PixelFault::OffRay)};
}

std::string DropCounts::text() const {
  return fmt::format("{} not finite, {} with a normal that is not unit, {} that do not project to their pixel",
                     not_finite, bad_normal, off_ray);
}

std::size_t select_by_budget(std::span<const std::uint32_t, kRanks> of_rank, const SamplingOptions& options,
                             RoundCounts& counts) {
  counts.cameras_per_surface =
      options.cameras_per_surface > 0 ? options.cameras_per_surface : cameras_within_budget(of_rank, options.budget);
  const auto most = static_cast<std::size_t>(counts.cameras_per_surface);
  std::size_t survived = 0;
  counts.valid = 0;
  for (std::size_t rank = 1; rank < kRanks; ++rank) {
    counts.valid += of_rank[rank];
    if (rank <= most) survived += of_rank[rank];
  }
  counts.culled = counts.valid - survived;
  return survived;
}

Sampler::Sampler(Device device)
    : stream_(device),
      views_(stream_),
      moved_(stream_),
      depth_m_(stream_),
      cosine_(stream_),
      surfels_(stream_),
      edges_(stream_),
      ranks_(stream_),
      tally_(stream_, 1),
      linear_(stream_),
      candidate_pixel_(stream_),
      kept_(stream_),
      candidate_position_(stream_),
      candidate_area_m2_(stream_),
      candidate_weight_(stream_),
      position_(stream_),
      normal_(stream_),
      albedo_(stream_),
      color_(stream_),
      spacing_m_(stream_),
      object_id_(stream_),
      pixel_(stream_) {
  const LinearTable table = linear_table();
  linear_.assign(&table, 1);
  stream_.wait();
}

RoundSamples Sampler::sample(Views views, const ObjectTransforms& round_objects, const SamplingOptions& options) {
  RoundSamples round{.memory = stream_.view().device};
  if (views.empty()) return round;
  const RoundPixels pixels = measure(views, round_objects, options);
  const RoundTally tally = tally_.to_host().front();
  for (std::uint32_t v = 0; v < pixels.view_count; ++v) round.dropped.push_back(dropped_of(tally.faults[v]));
  const std::size_t survived = select_by_budget(tally.of_rank, options, round);
  const Candidates candidates = make_candidates(survived);
  select_candidates(stream_, pixels, round.cameras_per_surface, candidates);
  const Samples samples = make_samples(
      thin_to_budget(stream_, candidates.position, candidates.weight, candidates.count, options.budget, kept_));
  round.thinned = survived - samples.count;
  write_samples(stream_, pixels, candidates, kept_.data(), spacing_growth(survived, samples.count), linear_.data(),
                samples);
  estimate_spacing(stream_, samples.position, samples.normal, samples.count, samples.spacing_m);
  stream_.wait();
  round.size = samples.count;
  round.position = samples.position;
  round.normal = samples.normal;
  round.albedo = samples.albedo;
  round.color = samples.color;
  round.spacing_m = samples.spacing_m;
  round.object_id = samples.object_id;
  round.pixel = samples.pixel;
  round.depth_m = pixels.depth_m;
  return round;
}

RoundPixels Sampler::measure(Views views, const ObjectTransforms& round_objects, const SamplingOptions& options) {
  const RoundPixels pixels = upload(views, round_objects);
  measure_surfels(stream_, pixels, options.min_cosine);
  rank_across_cameras(stream_, pixels, options.culling);
  return pixels;
}

RoundPixels Sampler::upload(Views views, const ObjectTransforms& round_objects) {
  const Camera& camera = views.front()->camera;
  const std::size_t count = views.size() * views.front()->pixels();
  if (views.size() > kMaxViews || count > kMaxPixels) {
    throw std::runtime_error(fmt::format("{} input views of {} x {} pixels; at most {} views and {} pixels are sampled",
                                         views.size(), camera.width, camera.height, kMaxViews, kMaxPixels));
  }
  std::vector<PixelView> tables;
  std::vector<MovedObject> moved;
  for (const InputView* view : views) {
    assert(view->camera.width == camera.width && view->camera.height == camera.height);
    assert(view->memory == stream_.view().device);
    const std::size_t first = moved.size();
    add_moved(view->objects, round_objects, moved);
    tables.push_back(
        pixel_view(*view, view->objects.contains(kFarFieldFrame) && round_objects.contains(kFarFieldFrame)));
    tables.back().moved_count = static_cast<std::uint32_t>(moved.size() - first);
  }
  moved_.assign(moved);
  const MovedObject* next = moved_.data();
  for (PixelView& table : tables) {
    table.moved = next;
    next += table.moved_count;
  }
  views_.assign(tables);
  depth_m_.resize(count);
  cosine_.resize(count);
  surfels_.resize(count);
  edges_.resize(count);
  ranks_.resize(count);
  tally_.clear();
  stream_.wait();  // for the tables
  return {.views = views_.data(),
          .view_count = static_cast<std::uint32_t>(views.size()),
          .view_pixels = static_cast<std::uint32_t>(views.front()->pixels()),
          .far_field = {kFarFieldFrame, portable(kFarFieldCentre), kFarFieldRadius},
          .movement = !moved.empty(),
          .depth_m = depth_m_.data(),
          .cosine = cosine_.data(),
          .surfels = surfels_.data(),
          .edges = edges_.data(),
          .ranks = ranks_.data(),
          .tally = tally_.data()};
}

Candidates Sampler::make_candidates(std::size_t count) {
  candidate_pixel_.resize(count);
  candidate_position_.resize(3 * count);
  candidate_area_m2_.resize(count);
  candidate_weight_.resize(count);
  return {static_cast<std::uint32_t>(count), candidate_pixel_.data(), candidate_position_.data(),
          candidate_area_m2_.data(), candidate_weight_.data()};
}

Samples Sampler::make_samples(std::size_t count) {
  for (auto* vectors : {&position_, &normal_, &albedo_, &color_}) vectors->resize(3 * count);
  spacing_m_.resize(count);
  object_id_.resize(count);
  pixel_.resize(count);
  return {.count = static_cast<std::uint32_t>(count),
          .position = position_.data(),
          .normal = normal_.data(),
          .albedo = albedo_.data(),
          .color = color_.data(),
          .spacing_m = spacing_m_.data(),
          .object_id = object_id_.data(),
          .pixel = pixel_.data()};
}

}  // namespace splatbus::capture_bridge
