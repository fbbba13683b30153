#include "dynamics_shots.h"

#include <fmt/format.h>

#include <algorithm>
#include <span>
#include <utility>

#include "metrics/image_io.h"
#include "shadow_mask.h"

namespace splatbus::cli {

namespace {

constexpr int kMovingReach = 5;  // pixels, as far as a window of SSIM does
constexpr int kShadowReach = 10;
constexpr int kLeastPixels = 48;  // of an object that is judged by itself

}  // namespace

std::set<std::uint32_t> ids_of(const ObjectTransforms& objects) {
  std::set<std::uint32_t> ids;
  for (const auto& [id, transform] : objects) ids.insert(id);
  return ids;
}

cv::Mat GhostMasks::take(std::size_t camera, double time_s, const ObjectTransforms& objects, const cv::Mat& object_id) {
  Seen& seen = cameras_[camera];
  for (const auto& [id, transform] : seen.objects) {
    if (!objects.contains(id)) seen.ghosts[id] = {.mask = mask_of(seen.object_id, {id}), .since_s = time_s};
  }
  std::erase_if(seen.ghosts, [&](const auto& ghost) {
    return objects.contains(ghost.first) || time_s - ghost.second.since_s > to_s_;
  });
  seen.objects = objects;
  seen.object_id = object_id;
  cv::Mat mask;
  for (const auto& [id, ghost] : seen.ghosts) {
    if (time_s - ghost.since_s < from_s_) continue;
    mask.empty() ? ghost.mask.copyTo(mask) : cv::bitwise_or(mask, ghost.mask, mask);
  }
  if (mask.empty()) return mask;
  mask.setTo(0, grown(mask_of(object_id, ids_of(objects)), kMovingReach));
  return grown(mask, 0);
}

void DynamicsShots::add(std::size_t sample, std::size_t camera, const ProbePicture& probe, const SceneLights* lights,
                        const Drawn& drawn) {
  Shot shot{.sample = sample, .drawn = drawn, .moving = {}, .shadow = {}, .ghost = {}, .settled = {}, .objects = {}};
  make_masks(camera, probe, lights, shot);
  shots_.push_back(std::move(shot));
}

void DynamicsShots::make_masks(std::size_t camera, const ProbePicture& probe, const SceneLights* lights, Shot& shot) {
  if (probe.object_id.empty()) return;
  Before now{.moving = mask_of(probe.object_id, ids_of(probe.scene.objects)), .lit = {}};
  shot.moving = grown(now.moving, kMovingReach);
  for (const auto& [id, transform] : probe.scene.objects) {
    cv::Mat mask = grown(mask_of(probe.object_id, {id}), 0);
    if (cv::countNonZero(mask) >= kLeastPixels) shot.objects.emplace(id, std::move(mask));
  }
  shot.ghost = ghosts_.take(camera, probe.time_s, probe.scene.objects, probe.object_id);
  shot.settled = settled_.take(camera, probe.time_s, probe.scene.objects, probe.object_id);
  const relight::LightMaps* const sun = lights != nullptr ? lights->front().maps.get() : nullptr;
  if (sun == nullptr || probe.depth.empty()) return;
  now.lit = lit_surfaces(probe.depth, probe.camera, *sun);
  const auto before = before_.find(camera);
  if (before != before_.end()) {
    shot.shadow = moving_shadow_edges(before->second.lit, now.lit, now.moving | before->second.moving, kShadowReach);
  }
  before_[camera] = std::move(now);
}

MaskedFigures DynamicsShots::masked_figures(const cv::Mat& map, const Shot& shot) {
  MaskedFigures figures;
  if (!shot.moving.empty()) figures.moving = masked_mean(map, shot.moving);
  if (!shot.shadow.empty()) figures.shadow = masked_mean(map, shot.shadow);
  return figures;
}

std::optional<DrawnFigures> DynamicsShots::figures(const Shot& shot, const cv::Mat& drawn, const DynamicsSample& sample,
                                                   bool is_on) {
  if (drawn.empty()) return {};
  cv::Mat ssim_map, flip_map;
  const cv::Mat& engine = shot.drawn.engine;
  const double ssim = metrics::ssim(drawn, engine, &ssim_map);
  const double flip = metrics::flip(drawn, engine, metrics::kFlipPixelsPerDegree, &flip_map);
  DrawnFigures result{.whole = {.psnr_db = metrics::psnr(drawn, engine), .ssim = ssim, .flip = flip},
                      .masked = masked_figures(ssim_map, shot),
                      .masked_psnr = {},
                      .masked_flip = masked_figures(flip_map, shot),
                      .object_ssim = {},
                      .ghost_flip = {},
                      .settled_flip = {}};
  if (!shot.moving.empty()) result.masked_psnr.moving = masked_psnr(drawn, engine, shot.moving);
  if (!shot.shadow.empty()) result.masked_psnr.shadow = masked_psnr(drawn, engine, shot.shadow);
  for (const auto& [id, mask] : shot.objects) result.object_ssim[id] = *masked_mean(ssim_map, mask);
  if (!shot.ghost.empty()) result.ghost_flip = masked_mean(flip_map, shot.ghost);
  if (!shot.settled.empty()) result.settled_flip = masked_mean(flip_map, shot.settled);
  if (is_on && !sample.extra && window_.contains(sample.time_s)) {
    maps_[sample.camera].ssim.add(ssim_map);
    maps_[sample.camera].flip.add(flip_map);
  }
  return result;
}

void DynamicsShots::compare(std::vector<DynamicsSample>& samples, std::size_t kept) {
  const std::size_t count = shots_.size() - std::min(kept, shots_.size());
  for (const Shot& shot : std::span(shots_).first(count)) {
    DynamicsSample& sample = samples[shot.sample];
    sample.on = figures(shot, shot.drawn.on, sample, true);
    sample.off = figures(shot, shot.drawn.off, sample, false);
    sample.viewer = figures(shot, viewer_picture(sample.probe_id), sample, false);
    if (still_ == nullptr) continue;
    const auto maps = still_->find(sample.camera);
    if (maps == still_->end()) continue;
    sample.still = masked_figures(maps->second.ssim, shot);
    if (!shot.ghost.empty()) sample.still_ghost_flip = masked_mean(maps->second.flip, shot.ghost);
  }
  shots_.erase(shots_.begin(), shots_.begin() + static_cast<std::ptrdiff_t>(count));
}

cv::Mat DynamicsShots::viewer_picture(std::uint64_t probe_id) const {
  const std::filesystem::path file = viewer_ / fmt::format("probe_{}_viewer.png", probe_id);
  return std::filesystem::exists(file) ? metrics::read_png(file) : cv::Mat();
}

MapsOfCameras DynamicsShots::mean_maps() const {
  MapsOfCameras means;
  for (const auto& [camera, maps] : maps_) means[camera] = {.ssim = maps.ssim.mean(), .flip = maps.flip.mean()};
  return means;
}

}  // namespace splatbus::cli
