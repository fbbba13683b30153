#include "probe_round.h"

#include <fmt/format.h>

#include <cassert>
#include <glm/gtc/constants.hpp>
#include <utility>

#include "metrics/image_io.h"
#include "wire/capture_generated.h"
#include "wire/convert.h"
#include "wire/viewer_generated.h"

namespace splatbus::cli {

namespace {

/// A tensor [height][width] of 4-byte elements, as CV_32SC1 or CV_32FC1; empty where it is not there any more.
cv::Mat optional_plane(const bus::Message& message, const char* name, bus::ElementType type, const cv::Size& size) {
  const auto tensor =
      message.tensor(name, type, {static_cast<std::uint32_t>(size.height), static_cast<std::uint32_t>(size.width)});
  if (!tensor) return {};
  cv::Mat plane(size, type == bus::ElementType::F32 ? CV_32FC1 : CV_32SC1);
  if (!tensor->copy(plane.data)) return {};
  return plane;
}

}  // namespace

std::optional<ProbePicture> to_probe_picture(const bus::Message& message) {
  const auto& probe = message.root<wire::CaptureProbe>();
  ProbePicture picture{.probe_id = probe.probe_id(),
                       .camera = from_wire(*probe.camera()),
                       .scene = from_wire(*probe.scene()),
                       .time_s = probe.scene()->time_s(),
                       .picture = {},
                       .object_id = {},
                       .depth = {}};
  const auto color = message.tensor("color", bus::ElementType::U8, {picture.camera.height, picture.camera.width, 4});
  if (!color) return std::nullopt;
  std::vector<std::uint8_t> rgba(color->bytes());
  if (!color->copy(rgba.data())) return std::nullopt;
  picture.picture = metrics::from_rgba(rgba.data(), picture.camera.width, picture.camera.height);
  picture.object_id = optional_plane(message, "object_id", bus::ElementType::U32, picture.picture.size());
  picture.depth = optional_plane(message, "depth", bus::ElementType::F32, picture.picture.size());
  return picture;
}

ProbeRounds::ProbeRounds(const std::shared_ptr<bus::Context>& context, std::vector<Camera> cameras)
    : cameras_(std::move(cameras)),
      publisher_(context),
      answers_(context, {std::string(topics::kCaptureProbe.name)}),
      // Beside the ids that viewers count from 1, and other than those of a command that ran before.
      next_id_(static_cast<std::uint64_t>(bus::now_ns())),
      oldest_id_(next_id_) {}

void ProbeRounds::begin() {
  begin(cameras_.size());
}

void ProbeRounds::begin(std::vector<Camera> cameras) {
  assert(cameras.size() <= kMaxCameras);
  cameras_ = std::move(cameras);
  begin();
}

void ProbeRounds::begin(std::size_t count) {
  first_id_ = next_id_;
  next_id_ += kMaxCameras;
  pictures_.clear();
  asked_ = count;
  for (std::size_t i = 0; i < asked_; ++i) ask(i);
}

void ProbeRounds::ask_again(std::size_t camera) {
  if (first_id_ != 0) ask(camera);
}

std::optional<std::size_t> ProbeRounds::camera_of(std::uint64_t probe_id) const {
  if (probe_id < oldest_id_ || probe_id >= next_id_) return {};
  return static_cast<std::size_t>((probe_id - oldest_id_) % kMaxCameras);
}

void ProbeRounds::ask(std::size_t index) {
  const wire::Camera camera = to_wire(cameras_[index]);
  publisher_.publish(topics::kViewerProbe, [&](auto& builder, auto header) {
    return wire::CreateViewerProbe(builder, header, first_id_ + index, &camera);
  });
}

void ProbeRounds::poll(std::chrono::milliseconds timeout,
                       const std::function<void(std::size_t, const ProbePicture&)>& handle) {
  for (auto message = answers_.receive(timeout); message; message = answers_.receive(std::chrono::milliseconds(0))) {
    bus::guarded(*message, [&] {
      const auto& probe = message->root<wire::CaptureProbe>();
      if (first_id_ == 0 || probe.probe_id() < first_id_ || probe.probe_id() - first_id_ >= cameras_.size()) return;
      const auto index = static_cast<std::size_t>(probe.probe_id() - first_id_);
      if (pictures_.contains(index)) return;
      auto picture = to_probe_picture(*message);
      if (!picture) return;
      handle(index, pictures_.emplace(index, std::move(*picture)).first->second);
    });
  }
}

std::vector<Camera> circle_cameras(const Circle& circle) {
  std::vector<Camera> cameras;
  const auto size = static_cast<std::uint32_t>(circle.size);
  for (int i = 0; i < circle.count; ++i) {
    const float angle = glm::radians(circle.phase_degrees) +
                        glm::two_pi<float>() * static_cast<float>(i) / static_cast<float>(circle.count);
    const glm::vec3 eye(circle.target.x + circle.radius_m * std::cos(angle), circle.height_m,
                        circle.target.z + circle.radius_m * std::sin(angle));
    Camera camera = look_at(eye, circle.target, size, size, glm::radians(circle.fov_degrees));
    camera.id = static_cast<std::uint32_t>(i);
    camera.role = CameraRole::Probe;
    cameras.push_back(camera);
  }
  return cameras;
}

std::vector<std::pair<std::string, std::string>> ring_parameters(const Circle& circle) {
  return {{"reference_rig", "ring"},
          {"reference_cameras", std::to_string(circle.count)},
          {"reference_size", std::to_string(circle.size)},
          {"fov_deg", fmt::format("{}", circle.fov_degrees)},
          {"ring_radius_m", fmt::format("{}", circle.radius_m)},
          {"ring_height_m", fmt::format("{}", circle.height_m)},
          {"ring_phase_deg", fmt::format("{}", circle.phase_degrees)},
          {"ring_target", fmt::format("{},{},{}", circle.target.x, circle.target.y, circle.target.z)}};
}

}  // namespace splatbus::cli
