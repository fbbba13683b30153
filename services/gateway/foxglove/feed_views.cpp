// What the feed makes for Foxglove's own schemas: frames, cameras, pictures and points.
#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "bus/frames.h"
#include "gateway/foxglove/convert.h"
#include "gateway/foxglove/feed.h"
#include "gateway/foxglove/point_sample.h"
#include "metrics/image_io.h"
#include "wire/capture_generated.h"
#include "wire/convert.h"
#include "wire/engine_generated.h"
#include "wire/scene_generated.h"
#include "wire/schemas.h"
#include "wire/viewer_generated.h"

namespace splatbus::gateway::foxglove {

namespace {

constexpr std::size_t kMaxCameras = 64, kMaxEngines = 64;
constexpr std::size_t kMaxDepthBytes = std::size_t{64} << 20;  // of one picture, which is sent as it is

std::string calibration_topic(const std::string& camera) {
  return fmt::format("foxglove/cameras/{}/calibration", camera);
}

std::string picture_topic(const std::string& camera) {
  return fmt::format("foxglove/cameras/{}/picture", camera);
}

std::string depth_topic(const std::string& camera) {
  return fmt::format("foxglove/cameras/{}/depth", camera);
}

std::vector<Offer> offers_of(const std::map<std::string, CameraRole>& cameras) {
  const auto calibration = wire::foxglove_schema("foxglove.CameraCalibration");
  const auto picture = wire::foxglove_schema("foxglove.CompressedImage");
  const auto depth = wire::foxglove_schema("foxglove.RawImage");
  std::vector<Offer> offers;
  for (const auto& [camera, role] : cameras) {
    offers.push_back({calibration_topic(camera), std::string(calibration.table), calibration.binary, {}});
    if (role != CameraRole::Reference) continue;  // the bridge makes samples of the others' pictures
    offers.push_back({picture_topic(camera), std::string(picture.table), picture.binary, {}});
    offers.push_back({depth_topic(camera), std::string(depth.table), depth.binary, {}});
  }
  return offers;
}

}  // namespace

void Feed::follow_asker(const bus::Message& message, Source& source) {
  std::pair by(message.header().source()->str(), message.header().epoch());
  if (by == cameras_by_) return;
  cameras_by_ = std::move(by);
  cameras_of_.clear();
  source.held.clear();
}

void Feed::take_cameras(const bus::Message& message, const Channels& channels) {
  const auto& body = message.root<wire::EngineCameras>();
  std::map<std::string, Camera> cameras;
  if (body.cameras() != nullptr) {
    for (const auto* request : *body.cameras()) {
      const Camera camera = from_wire(*request->camera());
      if (camera.role != CameraRole::Input && camera.role != CameraRole::Reference) continue;
      if (cameras.size() < kMaxCameras) cameras.emplace(camera_name(camera), camera);
    }
  }
  Cameras roles;
  for (const auto& [name, camera] : cameras) roles.emplace(name, camera.role);
  const auto* key = message.header().latch_key();
  const std::string engine = key == nullptr ? std::string() : bus::printable(key->string_view());
  if (roles.empty()) {
    cameras_of_.erase(engine);
  } else if (cameras_of_.contains(engine) || cameras_of_.size() < kMaxEngines) {
    cameras_of_[engine] = std::move(roles);
  }
  Cameras all;
  for (const auto& [asked, of_engine] : cameras_of_) {
    for (const auto& one : of_engine) {
      if (all.size() < kMaxCameras) all.insert(one);
    }
  }
  if (all != cameras_) hub_.offer(Hub::Kind::Cameras, offers_of(all));
  cameras_ = std::move(all);
  const std::uint64_t time = time_of(message);
  std::vector<FrameTransform> frames;
  for (const auto& [name, camera] : cameras) {
    const std::string topic = calibration_topic(name), frame = camera_frame(name);
    if (channels.contains(topic)) hub_.deliver(topic, time, camera_calibration(camera, frame, time), "");
    frames.push_back({std::string(kWorld), frame, camera.world_from_camera});
  }
  if (channels.contains(std::string(kTransforms))) {
    hub_.deliver(std::string(kTransforms), time, frame_transforms(frames, time), "cameras" + engine);
  }
}

void Feed::take_scene(const bus::Message& message) {
  const SceneState scene = from_wire(*message.root<wire::SceneUpdate>().scene());
  hub_.deliver(std::string(kTransforms), time_of(message),
               frame_transforms(object_frames(scene.objects), time_of(message)), "objects");
}

void Feed::take_pose(const bus::Message& message, const Channels& channels) {
  const auto& body = message.root<wire::ViewerPose>();
  const Camera camera = from_wire(*body.camera());
  const std::string viewer = bus::printable(body.viewer()->string_view());
  const std::string frame = "viewer/" + viewer;
  const std::uint64_t time = time_of(message);
  if (channels.contains(std::string(kTransforms))) {
    hub_.deliver(std::string(kTransforms), time,
                 frame_transforms({{std::string(kWorld), frame, camera.world_from_camera}}, time), frame);
  }
  if (channels.contains(std::string(kViewers))) {
    hub_.deliver(std::string(kViewers), time, camera_calibration(camera, frame, time), viewer);
  }
}

void Feed::take_reference(const bus::Message& message, const Channels& channels) {
  const auto& body = message.root<wire::CaptureReference>();
  const std::string name = camera_name(from_wire(*body.camera()));
  if (body.retire()) return;
  if (channels.contains(picture_topic(name))) send_picture(message, picture_topic(name), camera_frame(name));
  if (channels.contains(depth_topic(name))) send_depth(message, depth_topic(name), camera_frame(name));
}

void Feed::take_probe(const bus::Message& message, const Channels& channels) {
  const Camera camera = from_wire(*message.root<wire::CaptureProbe>().camera());
  const std::string frame = camera_frame("probe");
  const std::uint64_t time = time_of(message);
  if (channels.contains(std::string(kTransforms))) {
    hub_.deliver(std::string(kTransforms), time,
                 frame_transforms({{std::string(kWorld), frame, camera.world_from_camera}}, time), frame);
  }
  if (channels.contains(std::string(kProbeCalibration))) {
    hub_.deliver(std::string(kProbeCalibration), time, camera_calibration(camera, frame, time), "");
  }
  if (channels.contains(std::string(kProbePicture))) send_picture(message, std::string(kProbePicture), frame);
  if (channels.contains(std::string(kProbeDepth))) send_depth(message, std::string(kProbeDepth), frame);
}

bool Feed::picture_is_due(const std::string& topic) const {
  const auto next = next_picture_ns_.find(topic);
  return next == next_picture_ns_.end() || bus::now_ns() >= next->second;
}

void Feed::deliver_picture(const std::string& topic, std::uint64_t time, Payload payload) {
  next_picture_ns_[topic] = bus::now_ns() + static_cast<std::int64_t>(1e9 / options_.foxglove.pictures_hz);
  hub_.deliver(topic, time, std::move(payload), "");
}

void Feed::send_picture(const bus::Message& message, const std::string& topic, const std::string& frame) {
  if (!picture_is_due(topic)) return;
  const auto color = message.tensor("color", bus::ElementType::U8, {0, 0, 4});
  if (!color) return;
  std::vector<std::uint8_t> rgba(color->bytes());
  if (!color->copy(rgba.data())) return;
  const cv::Mat picture = metrics::from_rgba(rgba.data(), color->dim(1), color->dim(0));
  const std::uint64_t time = time_of(message);
  deliver_picture(topic, time, compressed_image(picture, options_.foxglove.png, frame, time));
}

void Feed::send_depth(const bus::Message& message, const std::string& topic, const std::string& frame) {
  if (!picture_is_due(topic) || !message.announces("depth")) return;
  const auto depth = message.tensor("depth", bus::ElementType::F32, {0, 0});
  if (!depth || depth->bytes() > kMaxDepthBytes) return;
  cv::Mat metres(static_cast<int>(depth->dim(0)), static_cast<int>(depth->dim(1)), CV_32FC1);
  if (!depth->copy(metres.data)) return;
  const std::uint64_t time = time_of(message);
  deliver_picture(topic, time, depth_image(metres, frame, time));
}

void Feed::send_points(std::int64_t now_ns) {
  scene_->poll(std::chrono::milliseconds(0));
  if (now_ns < next_points_ns_ || !scene_->published() || !scene_->has_scene()) return;
  if (scene_->published()->count > options_.max_model_gaussians) return;
  const PublishedModel* model = scene_->model();
  if (model == nullptr) return;
  const std::string points = sample_points(model->average(), scene_->scene(), options_.foxglove.points);
  if (!model->still_valid()) return;
  next_points_ns_ = now_ns + static_cast<std::int64_t>(1e9 / options_.foxglove.points_hz);
  hub_.deliver(std::string(kPoints), utc(now_ns), point_cloud(points, utc(now_ns)), "");
}

}  // namespace splatbus::gateway::foxglove
