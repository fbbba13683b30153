#include "viewer/gl/flight.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <numbers>
#include <optional>
#include <random>
#include <utility>
#include <vector>

namespace splatbus::viewer::gl {
namespace {

constexpr double kWarmUp = 0.1;  // of the flight
constexpr float kFov_radians = std::numbers::pi_v<float> / 3;
constexpr float kSide_m = 10;
constexpr GLuint64 kPatience_ns = 10'000'000'000;

Camera camera_at(const Bounds& bounds, float part, std::uint32_t width, std::uint32_t height) {
  const float turn = 2 * std::numbers::pi_v<float> * part;
  const float pitch = 0.35F + 0.2F * std::sin(2 * turn), distance = bounds.radius_m * (1.4F + 0.9F * std::cos(turn));
  const glm::vec3 backward(std::cos(pitch) * std::cos(turn), std::sin(pitch), std::cos(pitch) * std::sin(turn));
  return look_at(bounds.centre + distance * backward, bounds.centre, width, height, kFov_radians);
}

double quantile(std::vector<double> values, double part) {
  if (values.empty()) return 0;
  const auto nth = std::min(static_cast<std::size_t>(part * static_cast<double>(values.size())), values.size() - 1);
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(nth), values.end());
  return values[nth];
}

StepTimes medians(const std::vector<StepTimes>& pictures) {
  StepTimes out;
  for (double StepTimes::*const step :
       {&StepTimes::project_ms, &StepTimes::sort_ms, &StepTimes::pairs_ms, &StepTimes::tile_sort_ms,
        &StepTimes::draw_ms, &StepTimes::resolve_ms, &StepTimes::all_ms}) {
    std::vector<double> values;
    values.reserve(pictures.size());
    for (const StepTimes& picture : pictures) values.push_back(picture.*step);
    out.*step = quantile(std::move(values), 0.5);
  }
  return out;
}

Drawn since(const Drawn& before, const Drawn& now) {
  return {.by_quads = now.by_quads - before.by_quads,
          .by_tiles = now.by_tiles - before.by_tiles,
          .without_room = now.without_room - before.without_room,
          .pairs = now.pairs};
}

/// The rows that a stream would have changed since it was asked last.
class ChangingRows {
 public:
  explicit ChangingRows(const FlightChanges& changes) : changes_(changes) {}

  Batch since(double seconds) {
    Batch batch;
    if (!changes_.of) return batch;
    const RowUpdate& all = changes_.of->update;
    due_ = std::min(due_ + seconds * changes_.rows_per_s, static_cast<double>(all.rows.size()));
    batch.object_ids = changes_.of->object_ids;
    for (; due_ >= 1; --due_) {
      batch.update.rows.push_back(all.rows[next_]);
      batch.update.records.push_back(all.records[next_]);
      batch.update.fades.push_back(all.fades[next_]);
      next_ = (next_ + 1) % all.rows.size();
    }
    return batch;
  }

 private:
  const FlightChanges& changes_;
  double due_ = 0;
  std::size_t next_ = 0;
};

class Target {
 public:
  Target(std::uint32_t width, std::uint32_t height)
      : texture_(make_texture(GL_TEXTURE_2D)), target_(make_framebuffer()) {
    glTextureStorage2D(texture_.get(), 1, GL_RGBA8, static_cast<GLsizei>(width), static_cast<GLsizei>(height));
    glNamedFramebufferTexture(target_.get(), GL_COLOR_ATTACHMENT0, texture_.get(), 0);
  }
  [[nodiscard]] GLuint get() const { return target_.get(); }

 private:
  GlTexture texture_;
  GlFramebuffer target_;
};

}  // namespace

SharedBatch wavy_floor(std::size_t gaussians) {
  auto batch = std::make_shared<Batch>();
  batch->whole = true;
  batch->object_ids = {kWorldFrame};
  batch->bounds = Bounds{.centre = {0, 0, 0}, .radius_m = kSide_m / 2};
  std::mt19937 random(1);
  std::uniform_real_distribution<float> uniform(-1, 1);
  const float sigma_m = kSide_m / std::sqrt(static_cast<float>(gaussians));
  const auto log_scale = [](float sigma) {
    return static_cast<std::int16_t>(std::lround(std::log(sigma) / stream::kLogScaleStep));
  };
  for (std::size_t k = 0; k < gaussians; ++k) {
    const float x = kSide_m / 2 * uniform(random), z = kSide_m / 2 * uniform(random);
    stream::GpuRecord record;
    record.mean = {x, 0.3F * std::sin(2 * x) * std::cos(2 * z), z};
    const float size = sigma_m * std::exp2(uniform(random));
    record.log_scale = {log_scale(size), log_scale(0.1F * size), log_scale(size)};
    for (std::int16_t& part : record.rotation) part = static_cast<std::int16_t>(3000 * uniform(random));
    record.opacity_object = static_cast<std::uint32_t>(150 + 100 * uniform(random));
    const float shade = 0.5F + 0.4F * uniform(random);
    record.color = stream::shared_exponent_rgb({shade, 0.5F + 0.1F * x / kSide_m, 1 - shade});
    batch->update.rows.push_back(static_cast<std::uint32_t>(k));
    batch->update.records.push_back(record);
    batch->update.fades.push_back(kNoFade);
  }
  return batch;
}

FlightFigures fly(Stage& stage, const SceneState& scene, const Bounds& bounds, std::uint32_t width,
                  std::uint32_t height, double seconds, const FlightChanges& changes) {
  using Clock = std::chrono::steady_clock;
  const Target target(width, height);
  stage.set_timed(true);
  FlightFigures figures;
  std::vector<double> intervals_ms;
  std::vector<StepTimes> steps;
  std::optional<Drawn> before_it_counts;
  std::array<GLsync, 2> fences{};
  ChangingRows changing(changes);
  const auto begin = Clock::now();
  auto before = begin, changed = begin;
  for (std::size_t frame = 0;; ++frame) {
    const double flown = std::chrono::duration<double>(Clock::now() - begin).count() / seconds;
    if (flown >= 1) break;
    const Camera camera = camera_at(bounds, static_cast<float>(flown), width, height);
    const auto asked = Clock::now();
    const Batch rows = changing.since(std::chrono::duration<double>(asked - std::exchange(changed, asked)).count());
    if (!rows.update.rows.empty()) stage.add(rows);
    figures.rows_changed += rows.update.rows.size();
    stage.draw(camera, scene, kSettled_s, target.get());
    GLsync& fence = fences.at(frame % fences.size());
    if (fence) {
      glClientWaitSync(fence, GL_SYNC_FLUSH_COMMANDS_BIT, kPatience_ns);
      glDeleteSync(fence);
    }
    fence = glFenceSync(GL_SYNC_GPU_COMMANDS_COMPLETE, 0);
    const auto now = Clock::now();
    const std::vector<StepTimes> done = stage.take_times();
    if (flown > kWarmUp) steps.insert(steps.end(), done.begin(), done.end());
    if (flown > kWarmUp) intervals_ms.push_back(std::chrono::duration<double, std::milli>(now - before).count());
    before = now;
    if (flown > kWarmUp && !before_it_counts) {
      before_it_counts = stage.drawn();
      before = Clock::now();
    }
  }
  figures.drawn = since(before_it_counts.value_or(Drawn{}), stage.drawn());
  stage.set_timed(false);
  for (GLsync fence : fences) {
    if (fence) glDeleteSync(fence);
  }
  figures.frames = intervals_ms.size();
  for (const double ms : intervals_ms) figures.seconds += ms / 1000;
  if (figures.seconds > 0) figures.frames_per_s = static_cast<double>(figures.frames) / figures.seconds;
  figures.median_ms = quantile(intervals_ms, 0.5);
  figures.p95_ms = quantile(intervals_ms, 0.95);
  figures.p99_ms = quantile(intervals_ms, 0.99);
  figures.device = medians(steps);
  return figures;
}

}  // namespace splatbus::viewer::gl
