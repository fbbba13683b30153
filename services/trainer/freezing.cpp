#include "trainer/freezing.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace splatbus::trainer {

namespace {

constexpr double kDecidePeriod_s = 1;
/// Fewer pictures of a page say nothing of its loss.
constexpr std::uint32_t kLeastLooks = 8;
/// A view teaches more when it comes nearer than by rounding and jitter of a camera.
constexpr float kNearer = 1.5F;
/// A view that shows less than this of the nearest one's detail has little to teach: it is one from afar.
constexpr float kAsNear = 0.5F;
/// Of what views from afar have shown, what a new mean of them counts for: they change as they move on.
constexpr double kNewFromAfar = 0.25;
constexpr float kNear_m = 2;  // nobody has to come nearer than twice that
/// What is nearer counts as being this near: cameras stand in the bounds of pages.
constexpr float kNearestDistance_m = 0.25F;
/// A grey level: errors below it are not told apart.
constexpr double kLeastError = 1.0 / 255;
/// light_change() from which a page has to learn again what it had settled with: of a sun alone, six degrees.
constexpr float kOtherLight = 0.1F;
/// Lights that are known again when they return, as a lamp's that blinks.
constexpr std::size_t kKnownLights = 4;
/// Under more lights in one window nothing settles anyway.
constexpr std::size_t kMostLights = 64;

bool contains(const std::vector<std::uint64_t>& ascending, std::uint64_t number) {
  return std::binary_search(ascending.begin(), ascending.end(), number);
}

void insert(std::vector<std::uint64_t>& ascending, std::uint64_t number) {
  const auto place = std::lower_bound(ascending.begin(), ascending.end(), number);
  if (ascending.size() < kMostLights && (place == ascending.end() || *place != number)) ascending.insert(place, number);
}

}  // namespace

float light_change(const Light& before, const Light& now) {
  // What arrives is a colour times a direction: the distance of two such products.
  const float sun_cosine = glm::dot(before.sun_direction, now.sun_direction);
  float changed = std::sqrt(std::max(glm::dot(before.sun_irradiance, before.sun_irradiance) +
                                         glm::dot(now.sun_irradiance, now.sun_irradiance) -
                                         2 * sun_cosine * glm::dot(before.sun_irradiance, now.sun_irradiance),
                                     0.0F));
  float all = std::max(glm::length(before.sun_irradiance), glm::length(now.sun_irradiance));
  float sky = 0, sky_before = 0, sky_now = 0;
  for (std::size_t k = 0; k < now.ambient_sh.size(); ++k) {
    const glm::vec3 difference = now.ambient_sh[k] - before.ambient_sh[k];
    sky += glm::dot(difference, difference);
    sky_before += glm::dot(before.ambient_sh[k], before.ambient_sh[k]);
    sky_now += glm::dot(now.ambient_sh[k], now.ambient_sh[k]);
  }
  changed += std::sqrt(sky);
  all += std::sqrt(std::max(sky_before, sky_now));
  for (const LightSource& source : before.sources) {
    const auto later = std::ranges::find(now.sources, source.id, &LightSource::id);
    const LightSource& other = later != now.sources.end() ? *later : LightSource{.intensity = glm::vec3(0)};
    const float most = std::max(glm::length(source.intensity), glm::length(other.intensity));
    const float moved_m = glm::distance(source.position, other.position);
    const float turned = source.kind == LightKind::Point ? 0 : glm::distance(source.direction, other.direction);
    changed += std::max(std::min(moved_m + turned, 1.0F) * most, glm::distance(source.intensity, other.intensity));
    all += most;
  }
  for (const LightSource& source : now.sources) {
    if (std::ranges::find(before.sources, source.id, &LightSource::id) != before.sources.end()) continue;
    changed += glm::length(source.intensity);
    all += glm::length(source.intensity);
  }
  return all > 0 ? changed / all : 0;
}

float nearest_px_per_m(const TrainingView& view, std::uint32_t frame_id, const PageBounds& bounds) {
  ObjectTransform world_from_frame;
  if (frame_id != kWorldFrame) {
    const auto object = view.scene.objects.find(frame_id);
    if (object == view.scene.objects.end()) return 0;
    world_from_frame = seen_from(view.camera.world_from_camera.translation, frame_id, object->second);
  }
  const glm::vec3 camera =
      inverse(world_from_frame.rigid) * view.camera.world_from_camera.translation / world_from_frame.scale;
  const glm::vec3 low(bounds.low.x, bounds.low.y, bounds.low.z), high(bounds.high.x, bounds.high.y, bounds.high.z);
  const float distance_m = world_from_frame.scale * glm::distance(camera, glm::clamp(camera, low, high));
  return view.camera.fx / std::max(distance_m, kNearestDistance_m);
}

Freezer::Page& Freezer::at(const model::PageStore& store, std::uint32_t page) {
  if (page >= pages_.size()) pages_.resize(page + 1);
  Page& of = pages_[page];
  const model::PageEntry& entry = store.table().entry(page);
  const std::uint64_t generation = entry.generation.load(std::memory_order_relaxed);
  if (of.generation == generation) return of;
  const model::PageStructure& now = entry.now;
  const bool frozen = now.state == model::PageState::Frozen;
  const bool same_place = of.frame_id == now.frame_id && of.morton_first == now.morton_first;
  // What a world folder had as frozen learned under any light: under the first that it is seen with, where there was
  // one alone.
  std::vector<std::uint64_t> settled_under;
  if (frozen && entry.loss < 0 && light_count_ <= 1) settled_under = {0};
  if (frozen && entry.loss >= 0 && same_place) settled_under = of.frozen ? of.settled_under : of.lights_before;
  const bool thawed = same_place && of.frozen && !frozen;
  LightNumbers lights_before;
  if (thawed) lights_before = of.lights_before;
  // With what was put in or taken out its loss is another. What views came to stays with the place.
  of = {.generation = generation,
        .frame_id = now.frame_id,
        .morton_first = now.morton_first,
        .count = now.count,
        .frozen = frozen,
        .since_s = store.optimizer_s(),
        .seen_s = same_place && !thawed && now.count <= of.count ? of.seen_s : store.optimizer_s(),
        .loss_before = thawed ? of.loss_before : -1.0,
        .px_per_m = same_place ? of.px_per_m : 0.0F,
        .loss_at_freeze = frozen ? static_cast<double>(entry.loss) : 0.0,
        .usual_from_afar = same_place ? of.usual_from_afar : -1.0,
        .lights_before = std::move(lights_before),
        .settled_under = std::move(settled_under)};
  return of;
}

std::optional<std::uint64_t> Freezer::number_of(const SceneState& scene) {
  const auto same = std::find_if(lights_.rbegin(), lights_.rend(), [&](const KnownLight& known) {
    return light_change(known.light, scene.light) <= kOtherLight;
  });
  const bool newest = scene.version >= newest_version_;
  newest_version_ = std::max(newest_version_, scene.version);
  if (same != lights_.rend()) return same->number;
  if (!newest) return {};
  lights_.push_back({light_count_, scene.light});
  if (lights_.size() > kKnownLights) lights_.pop_front();
  return light_count_++;
}

void Freezer::see(const model::PageStore& store, std::span<const ViewLook> looks) {
  if (first_seen_s_ < 0) first_seen_s_ = store.optimizer_s();
  for (const ViewLook& look : looks) {
    const std::optional<std::uint64_t> light = number_of(look.view->scene);
    for (const raster::PageLook& seen : look.pages) {
      model::PageEntry& entry = store.table().entry(seen.page);
      if (!is_present(entry.now.state)) continue;
      Page& page = at(store, seen.page);
      entry.contribution = static_cast<float>(seen.pairs);
      entry.last_seen_step = store.step();
      const float px_per_m = nearest_px_per_m(*look.view, entry.now.frame_id, entry.bounds);
      if (px_per_m < kAsNear * std::min(page.px_per_m, look.view->camera.fx / kNear_m)) {
        page.loss_from_afar += seen.error;
        page.looks_from_afar += 1;
        if (light && page.frozen && !contains(page.settled_under, *light)) page.unsettled_from_afar += 1;
        page.afar_px_per_m = std::max(page.afar_px_per_m, px_per_m);
        continue;
      }
      page.loss += seen.error;
      page.looks += 1;
      page.seen_s = store.optimizer_s();
      if (light && page.frozen && !contains(page.settled_under, *light)) page.unsettled_looks += 1;
      if (light) insert(page.lights, *light);
      float& nearest = page.frozen ? page.thawing_px_per_m : page.px_per_m;
      nearest = std::max(nearest, px_per_m);
    }
  }
}

std::optional<float> Freezer::learn_from_afar(Page& page, const FreezeOptions& options) {
  if (page.looks_from_afar < kLeastLooks) return {};
  const double loss = page.loss_from_afar / page.looks_from_afar;
  // Of what rests as it was nobody knows which lights it had settled under.
  const bool relit = page.loss_at_freeze > 0 && 2 * page.unsettled_from_afar >= page.looks_from_afar;
  const float px_per_m = std::exchange(page.afar_px_per_m, 0.0F);
  page.loss_from_afar = page.looks_from_afar = page.unsettled_from_afar = 0;
  if (page.usual_from_afar < 0) page.usual_from_afar = loss;
  const bool worse = loss > options.thaw_rise * page.usual_from_afar + kLeastError;
  page.times_worse = worse ? page.times_worse + 1 : 0;
  if (!worse) page.usual_from_afar += kNewFromAfar * (loss - page.usual_from_afar);
  // What passes before a page spoils a picture of it, not two.
  if (!relit && page.times_worse < 2) return {};
  page.usual_from_afar = -1;
  page.times_worse = 0;
  return px_per_m;
}

Freezer::Change Freezer::decide(const model::PageStore& store, const FreezeOptions& options,
                                std::span<const float> movements) {
  const double now_s = store.optimizer_s();
  next_s_ = now_s + std::min(kDecidePeriod_s, options.after_s);
  if (next_freeze_s_ < 0) next_freeze_s_ = first_seen_s_ + options.after_s;
  const bool may_freeze = now_s >= next_freeze_s_;
  if (may_freeze) next_freeze_s_ = now_s + options.after_s;
  Change change;
  const std::span<const IndexRange> ranges = store.view().ranges;
  for (std::size_t r = 0; r < ranges.size(); ++r) {
    const std::uint32_t number = ranges[r].first >> kPageShift;
    Page& page = at(store, number);
    model::PageEntry& entry = store.table().entry(number);
    entry.movement = movements[r];
    if (const std::optional<float> px_per_m = learn_from_afar(page, options)) {
      page.px_per_m = *px_per_m;
      page.seen_s = now_s;
      if (page.frozen) change.thaw.push_back(number);
      continue;
    }
    if (!page.frozen && may_freeze && now_s - page.seen_s > options.unseen_s) {
      entry.loss = 0;  // nobody knows what it would have come to: it goes on with what is seen of it next
      change.freeze.push_back(number);
      continue;
    }
    if (page.looks < kLeastLooks) continue;
    const double loss = page.loss / page.looks;
    if (page.frozen) {
      // Of one that a world folder had: what it is seen with first is what it rests at, and from there.
      if (page.loss_at_freeze < 0) entry.loss = static_cast<float>(page.loss_at_freeze = loss);
      if (page.px_per_m == 0) page.px_per_m = page.thawing_px_per_m;
      const bool nearer = page.px_per_m > 0 && page.thawing_px_per_m > kNearer * page.px_per_m;
      const bool worse = loss > options.thaw_rise * page.loss_at_freeze + kLeastError;
      const bool relit = 2 * page.unsettled_looks >= page.looks;
      if (nearer || worse || relit) change.thaw.push_back(number);
      // What it gains in the first window tells whether there was anything to gain.
      page.loss_before = worse && !relit && !nearer ? loss : -1;
      page.lights_before = std::exchange(page.lights, {});
      page.loss = page.looks = page.unsettled_looks = 0;
      continue;
    }
    entry.loss = static_cast<float>(loss);
    if (!may_freeze || now_s - page.since_s < options.after_s) continue;
    // Of windows under different lights neither says what the other gained.
    const bool settled = page.lights == page.lights_before && page.loss_before >= 0 &&
                         loss > (1 - options.least_gain) * page.loss_before;
    if (settled && movements[r] <= options.most_movement) change.freeze.push_back(number);
    page.loss_before = loss;
    page.lights_before = std::exchange(page.lights, {});
    page.loss = page.looks = 0;
    page.since_s = now_s;
  }
  return change;
}

}  // namespace splatbus::trainer
