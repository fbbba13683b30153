#include "raster/cuda/forward_pass.h"

#include <algorithm>
#include <stdexcept>

namespace splatbus::raster::cuda {
namespace {

void check_arguments(const DeviceGaussians& gaussians, const Camera& camera) {
  if (!gaussians.has_pages() && gaussians.count > gaussians.stride)
    throw std::invalid_argument("rasterizer: stride is below count");
  if (gaussians.count > 0 && gaussians.parameters == nullptr) throw std::invalid_argument("rasterizer: no parameters");
  if (camera.role == CameraRole::Light) throw std::invalid_argument("rasterizer: light cameras are orthographic");
  constexpr std::uint32_t kMaxSide = 1U << 15U;
  if (camera.width > kMaxSide || camera.height > kMaxSide) throw std::invalid_argument("rasterizer: picture too large");
}

}  // namespace

void ForwardPass::draw(const DeviceGaussians& gaussians, const Camera& camera, const SceneState& scene,
                       const RenderOptions& options, bool training) {
  check_arguments(gaussians, camera);
  const SceneView view{camera,
                       &scene,
                       gaussians.visibility_u8,
                       gaussians.visibility_stride,
                       gaussians.visibility_rows,
                       options.hidden_behind};
  const ViewTables tables = make_view_tables({&view, 1}, gaussians.layout.appearance);
  WorkspaceRequest request{.count = gaussians.count,
                           .batch = 1,
                           .width = static_cast<int>(camera.width),
                           .height = static_cast<int>(camera.height),
                           .range_count = gaussians.range_count,
                           .list_capacity = list_capacity_,
                           .object_count = tables.object_count,
                           .source_room = tables.source_room,
                           .object_slots = gaussians.object_id != nullptr,
                           .albedo = options.albedo && gaussians.layout.appearance == Appearance::Transfer,
                           .depth = options.depth,
                           .training = training,
                           .isect_capacity = isect_capacity_};
  project_ = {.blur_px2 = options.blur_px2, .antialias = options.antialias};
  for (;;) {
    workspace_.reserve(request);
    const WorkspaceView& w = workspace_.view();
    copy_tables(tables, gaussians, w);
    launch_clear_counts(w, stream());
    launch_project(gaussians, w, project_, stream());
    StepCounts counts{};
    check(cudaMemcpyAsync(&counts, w.counts, sizeof(counts), cudaMemcpyDeviceToHost, stream()),
          "reading the number of intersections");
    stream_.wait();
    if (counts.isects <= w.isect_capacity && counts.seen <= w.list_capacity) break;
    if (counts.isects > kMaxIsects)
      throw std::runtime_error("rasterizer: Gaussians meet more tiles than can be sorted");
    if (counts.seen > w.list_capacity) request.list_capacity = counts.seen + counts.seen / 4;
    if (counts.isects > w.isect_capacity) {
      request.isect_capacity = std::min(counts.isects + counts.isects / 4, kMaxIsects);
    }
  }
  isect_capacity_ = request.isect_capacity;
  list_capacity_ = request.list_capacity;
  launch_sort(workspace_.view(), stream());
  launch_blend_forward(gaussians, workspace_.view(), stream());
  stream_.wait();
}

void ForwardPass::copy_tables(const ViewTables& tables, const DeviceGaussians& gaussians, const WorkspaceView& w) {
  check(cudaMemcpyAsync(w.views, tables.views.data(), sizeof(DeviceView), cudaMemcpyHostToDevice, stream()),
        "copying views");
  check(cudaMemcpyAsync(w.object_views, tables.object_views.data(), sizeof(ObjectView) * tables.object_views.size(),
                        cudaMemcpyHostToDevice, stream()),
        "copying object views");
  check(cudaMemcpyAsync(w.object_ids, tables.object_ids.data(), sizeof(std::uint32_t) * tables.object_ids.size(),
                        cudaMemcpyHostToDevice, stream()),
        "copying object ids");
  check(cudaMemcpyAsync(w.sources, tables.sources.data(), sizeof(ShadingSource) * tables.sources.size(),
                        cudaMemcpyHostToDevice, stream()),
        "copying light sources");
  if (w.object_slot == nullptr) return;
  launch_object_slots(gaussians, w.object_ids, static_cast<int>(tables.object_ids.size()), w.object_slot, stream());
}

void ForwardPass::download(Render& out) const {
  const WorkspaceView& w = workspace_.view();
  const auto width = static_cast<std::uint32_t>(w.width), height = static_cast<std::uint32_t>(w.height);
  const auto copy = [&](const float* from, std::uint32_t channels) {
    Image image(width, height, channels);
    check(cudaMemcpyAsync(image.data.data(), from, sizeof(float) * image.data.size(), cudaMemcpyDeviceToHost, stream()),
          "copying a picture");
    return image;
  };
  out.color = copy(w.color, 3);
  out.alpha = copy(w.transmittance, 1);
  out.albedo = w.albedo != nullptr ? copy(w.albedo, 3) : Image();
  out.depth = w.depth != nullptr ? copy(w.depth, 1) : Image();
  stream_.wait();
  for (float& value : out.alpha.data) value = 1.0F - value;
}

}  // namespace splatbus::raster::cuda
