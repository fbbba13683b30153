// The memory of a step: what fits, what grows, what is refused.
#include "raster/cuda/workspace.h"

#include "cuda_scenes.h"
#include "raster/cuda/train_step.h"

namespace splatbus::raster::testing {
namespace {

constexpr cuda::WorkspaceRequest kSmall{.count = 100, .batch = 2, .width = 64, .height = 48, .isect_capacity = 1000};

TEST_F(CudaTest, AWorkspaceGrowsOnceAndServesAllSizes) {
  cuda::WorkspaceRequest wide = kSmall;
  wide.width = 128;
  wide.height = 16;
  wide.albedo = true;
  cuda::Workspace workspace;
  EXPECT_TRUE(workspace.reserve(kSmall));
  EXPECT_FALSE(workspace.reserve(kSmall));
  EXPECT_EQ(workspace.view().albedo, nullptr);
  EXPECT_TRUE(workspace.reserve(wide));
  EXPECT_NE(workspace.view().albedo, nullptr);
  EXPECT_EQ(workspace.view().tiles_x, 8);
  const std::size_t bytes = workspace.bytes();
  const float* const color = workspace.view().color;
  for (const cuda::WorkspaceRequest& request : {kSmall, wide}) {
    EXPECT_FALSE(workspace.reserve(request));
    EXPECT_EQ(workspace.bytes(), bytes);
    EXPECT_EQ(workspace.view().color, color);
    EXPECT_EQ(workspace.view().width, request.width);
    EXPECT_EQ(workspace.view().albedo != nullptr, request.albedo);
    EXPECT_EQ(workspace.view().segment_extra != nullptr, request.albedo);
  }
}

TEST_F(CudaTest, AWorkspacesArraysDoNotOverlap) {
  cuda::WorkspaceRequest all = kSmall;
  all.object_count = 3;
  all.object_slots = true;
  all.source_room = 4;
  all.range_count = 5;
  all.albedo = all.depth = true;
  cuda::Workspace workspace;
  workspace.reserve(all);
  const cuda::WorkspaceView& w = workspace.view();
  const std::size_t pixels = std::size_t{2} * 64 * 48, projected = 200, isects = 1000, tiles = 24;
  const auto span = [](const auto* array, std::size_t elements) {
    const auto begin = reinterpret_cast<std::uintptr_t>(array);
    return std::pair(begin, begin + elements * sizeof(*array));
  };
  std::vector<std::pair<std::uintptr_t, std::uintptr_t>> arrays = {
      span(w.projected_shape, 2 * projected),
      span(w.projected_tail, projected),
      span(w.projected_gradient, projected * cuda::kGradientFloats),
      span(w.projected_visible, projected),
      span(w.projected_depth_gradient, projected),
      span(w.counts, 1),
      span(w.range_marks, 5),
      span(w.listed, 5),
      span(w.isect_ids[0], isects),
      span(w.isect_ids[1], isects),
      span(w.flatten_ids[0], isects),
      span(w.flatten_ids[1], isects + 3),
      span(w.tile_offsets, tiles),
      span(static_cast<std::byte*>(w.sort_scratch), w.sort_scratch_bytes),
      span(w.segments, w.segment_capacity),
      span(w.segment_extra, 32 * std::size_t{w.segment_capacity}),
      span(w.color, 3 * pixels),
      span(w.transmittance, pixels),
      span(w.albedo, 3 * pixels),
      span(w.depth, pixels),
      span(w.color_gradient, 3 * pixels),
      span(w.albedo_gradient, 3 * pixels),
      span(w.depth_gradient, pixels),
      span(w.alpha_gradient, pixels),
      span(w.ssim_partials, 9 * pixels),
      span(w.views, 2),
      span(w.object_views, 6),
      span(w.object_ids, 3),
      span(w.sources, 8),
      span(w.object_slot, 100)};
  std::sort(arrays.begin(), arrays.end());
  for (std::size_t k = 1; k < arrays.size(); ++k) EXPECT_GE(arrays[k].first, arrays[k - 1].second) << k;
  EXPECT_GE(arrays.back().second - arrays.front().first, workspace.bytes() - 256);
  EXPECT_LE(arrays.back().second - arrays.front().first, workspace.bytes());
  // Segments' colours lie where the identifiers were.
  EXPECT_EQ(static_cast<void*>(w.segment_color), static_cast<void*>(w.isect_ids[0]));
  EXPECT_LE(32 * std::size_t{w.segment_capacity} * sizeof(float4), 2 * isects * sizeof(std::uint64_t));
}

TEST_F(CudaTest, MorePixelsThanALaunchTakesAreRefused) {
  cuda::Workspace workspace;
  workspace.reserve(kSmall);
  const std::size_t bytes = workspace.bytes();
  const cuda::WorkspaceRequest pixels{.count = 1, .batch = 2, .width = 32768, .height = 32768, .training = false};
  EXPECT_THROW(workspace.reserve(pixels), std::invalid_argument);
  const cuda::WorkspaceRequest gaussians{.count = 1 << 25, .batch = 1, .width = 16, .height = 16};
  EXPECT_THROW(workspace.reserve(gaussians), std::invalid_argument);
  EXPECT_EQ(workspace.bytes(), bytes);
}

}  // namespace
}  // namespace splatbus::raster::testing
