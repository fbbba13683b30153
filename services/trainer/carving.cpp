#include "trainer/carving.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "gaussians/portable.h"

namespace splatbus::trainer {

namespace {

using kernels::CameraOfFrame;

/// Pictures that may wait for the device before the caller does.
constexpr std::size_t kMaxLooks = 256;

/// Of the world and every object of the scene.
std::vector<CameraOfFrame> cameras_of(const Camera& camera, const ObjectTransforms& objects) {
  const auto width = static_cast<float>(camera.width), height = static_cast<float>(camera.height);
  const FrustumCamera pyramid{.fx = camera.fx,
                              .fy = camera.fy,
                              .cx = camera.cx,
                              .cy = camera.cy,
                              .width = width,
                              .height = height,
                              .near_m = camera.near_m,
                              .blur_px2 = 0,
                              .max_tan_x = 0,  // of means alone: what lies beside the picture is not judged
                              .max_tan_y = 0};
  const Rigid camera_from_world = inverse(camera.world_from_camera);
  std::vector<CameraOfFrame> cameras;
  cameras.reserve(1 + objects.size());
  const auto add = [&](std::uint32_t frame_id, const Rigid& camera_from_frame, float scale) {
    const math::Rigid rigid = portable(camera_from_frame);
    cameras.push_back(
        {frame_id, {rigid.rotation, rigid.translation, scale}, std::log(scale), page_frustum(pyramid, rigid, scale)});
  };
  static_assert(kWorldFrame == 0, "comes first");
  add(kWorldFrame, camera_from_world, 1);
  for (const auto& [id, world_from_object] : objects) {
    // No picture's depth says anything of the far field.
    if (id != kWorldFrame && id != kFarFieldFrame)
      add(id, camera_from_world * world_from_object.rigid, world_from_object.scale);
  }
  return cameras;
}

}  // namespace

Carver::Carver(device::StreamView stream) : stream_(stream), standing_(stream), counts_(stream, 2) {
  counts_.clear();
}

std::uint8_t Carver::instant_of(std::uint64_t frame) {
  const auto known = std::find(frames_.begin(), frames_.end(), frame);
  if (known != frames_.end()) return static_cast<std::uint8_t>(1 + (known - frames_.begin()));
  if (frames_.size() < kernels::kInstants) {
    frames_.push_back(frame);
    return static_cast<std::uint8_t>(frames_.size());
  }
  frames_[oldest_frame_] = frame;
  const auto instant = static_cast<std::uint8_t>(1 + oldest_frame_);
  oldest_frame_ = (oldest_frame_ + 1) % frames_.size();
  return instant;
}

void Carver::look(const TrainingViewPtr& view, const kernels::PagedGaussians& gaussians, const PageBounds* bounds,
                  const kernels::CarveLimits& limits, std::uint64_t step) {
  if (gaussians.range_count == 0) return;
  if (looks_.size() >= kMaxLooks) {
    stream_.wait();
    settled();
  }
  const Camera& camera = view->camera;
  Look& look = looks_.emplace_back(
      Look{step, view, cameras_of(camera, view->scene.objects), device::Buffer<CameraOfFrame>(stream_)});
  look.device_cameras.assign(std::span(std::as_const(look.cameras)));
  kernels::judge_gaussians(stream_, gaussians, bounds,
                           {.fx = camera.fx,
                            .fy = camera.fy,
                            .cx = camera.cx,
                            .cy = camera.cy,
                            .near_m = camera.near_m,
                            .far_m = camera.far_m,
                            .width = static_cast<int>(camera.width),
                            .height = static_cast<int>(camera.height),
                            .depth = view->depth.data(),
                            .cameras = look.device_cameras.data(),
                            .camera_count = static_cast<std::uint32_t>(look.cameras.size()),
                            .instant = instant_of(view->frame)},
                           limits, standing_.data(), counts_.data());
  if (!stream_.on_cuda()) settled();
}

std::size_t Carver::carvable(std::uint64_t done_step) {
  const std::size_t before = looks_.size();
  while (!looks_.empty() && looks_.front().step < done_step) looks_.pop_front();
  if (looks_.size() != before) count_carvable();
  return counted_ - carved_;
}

void Carver::settled() {
  if (looks_.empty()) return;
  looks_.clear();
  count_carvable();
}

void Carver::count_carvable() {
  // Not on the steps' stream, where more of them are under way.
  const device::StreamView stream = device::thread_stream(stream_.device);
  device::copy(stream, &counted_, counts_.data(), sizeof(counted_));
  stream.wait();
}

std::size_t Carver::mark(const kernels::PagedGaussians& gaussians, std::uint32_t votes, std::uint8_t* dead) {
  std::uint32_t marked[2] = {};
  device::fill(stream_, counts_.data() + 1, 0, sizeof(std::uint32_t));
  kernels::mark_free(stream_, gaussians, standing_.data(), votes, dead, counts_.data() + 1);
  device::copy(stream_, marked, counts_.data(), sizeof(marked));
  stream_.wait();
  looks_.clear();
  counted_ = carved_ = marked[0];
  return marked[1];
}

void Carver::follow(std::size_t count, const device::Buffer<IndexRange>& fresh, const model::Moves& moves) {
  standing_.grow(count);
  kernels::set_values(stream_, standing_.data(), fresh.data(), static_cast<std::uint32_t>(fresh.size()),
                      std::uint8_t{0});
  kernels::move_values(stream_, standing_.data(), moves);
}

}  // namespace splatbus::trainer
