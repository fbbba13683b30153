#include <utility>

#include "device/parallel.h"
#include "trainer/carving_kernels.h"

namespace splatbus::trainer {

namespace kernels {

namespace {

constexpr std::uint32_t kVoteBits = 4, kInstantMask = (1U << kVoteBits) - 1;

/// Items are `lanes` of a page at a time, which share the test of its bounds.
struct JudgeLanes {
  PagedGaussians gaussians;
  const PageBounds* bounds;
  DepthPicture picture;
  CarveLimits limits;
  std::uint32_t lanes;
  std::uint8_t* standing;
  std::uint32_t* carvable;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t item) const {
    const std::uint32_t items_a_page = kPageLanes / lanes, page = item / items_a_page;
    const IndexRange range = gaussians.ranges[page];
    const std::uint32_t first = item % items_a_page * lanes;
    if (first >= range.count) return;
    const CameraOfFrame* const camera = find(range.frame_id);
    if (camera == nullptr || !may_show(camera->frustum, bounds[page])) return;
    const std::uint32_t end = first + lanes < range.count ? first + lanes : range.count;
    for (std::uint32_t lane = first; lane < end; ++lane) take(range.first + lane, *camera);
  }

 private:
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER const CameraOfFrame* find(std::uint32_t frame_id) const {
    std::uint32_t first = 0, end = picture.camera_count;
    while (first < end) {
      const std::uint32_t middle = first + (end - first) / 2;
      if (picture.cameras[middle].frame_id < frame_id) {
        first = middle + 1;
      } else {
        end = middle;
      }
    }
    const bool found = first < picture.camera_count && picture.cameras[first].frame_id == frame_id;
    return found ? picture.cameras + first : nullptr;
  }
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER float value(int channel, std::uint32_t i) const {
    return *gaussians.memory.value(static_cast<std::uint32_t>(channel), i);
  }
  SPLATBUS_PORTABLE_MEMBER void take(std::uint32_t i, const CameraOfFrame& camera) const {
    constexpr int kMean = ParameterLayout::kMean, kScale = ParameterLayout::kLogScale;
    const math::Vec3 at =
        transformed(camera.camera_from_frame, {value(kMean, i), value(kMean + 1, i), value(kMean + 2, i)});
    if (!(at.z > picture.near_m)) return;
    const float growth = camera.log_scale;
    const Verdict verdict =
        judge(picture, at, {value(kScale, i) + growth, value(kScale + 1, i) + growth, value(kScale + 2, i) + growth});
    if (verdict == Verdict::Supported) standing[i] = picture.instant;
    if (verdict == Verdict::Free && value(ParameterLayout::kOpacityLogit, i) >= limits.min_opacity_logit) vote(i);
  }
  SPLATBUS_PORTABLE_MEMBER void vote(std::uint32_t i) const {
    const std::uint32_t votes = standing[i] >> kVoteBits;
    if ((standing[i] & kInstantMask) == picture.instant || votes >= limits.votes) return;
    standing[i] = static_cast<std::uint8_t>((votes + 1) << kVoteBits | picture.instant);
    if (votes + 1 == limits.votes) device::atomic_add(carvable, 1U);
  }
};

struct MarkFree {
  PagedGaussians gaussians;
  const std::uint8_t* standing;
  std::uint32_t votes;
  std::uint8_t* dead;
  std::uint32_t* count;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t item) const {
    const IndexRange range = gaussians.ranges[item / kPageLanes];
    const std::uint32_t lane = item % kPageLanes;
    if (lane >= range.count) return;
    const bool gone = standing[range.first + lane] >> kVoteBits >= votes;
    dead[range.first + lane] = gone ? 1 : 0;
    if (gone) device::atomic_add(count, 1U);
  }
};

}  // namespace

void judge_gaussians(StreamView stream, const PagedGaussians& gaussians, const PageBounds* bounds,
                     const DepthPicture& picture, const CarveLimits& limits, std::uint8_t* standing,
                     std::uint32_t* carvable) {
  const std::uint32_t lanes = stream.on_cuda() ? 1 : kTierLanes;
  device::for_each_index(stream, gaussians.range_count * (kPageLanes / lanes),
                         JudgeLanes{gaussians, bounds, picture, limits, lanes, standing, carvable});
}

void mark_free(StreamView stream, const PagedGaussians& gaussians, const std::uint8_t* standing, std::uint32_t votes,
               std::uint8_t* dead, std::uint32_t* count) {
  device::for_each_index(stream, gaussians.range_count * kPageLanes, MarkFree{gaussians, standing, votes, dead, count});
}

}  // namespace kernels

}  // namespace splatbus::trainer
