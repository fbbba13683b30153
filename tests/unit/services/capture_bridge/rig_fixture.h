#pragma once

#include <gtest/gtest.h>

#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "../../nanoseconds.h"
#include "capture-bridge/rig_control.h"
#include "wire/convert.h"

namespace splatbus::capture_bridge::test {

/// Poses as viewers tell them.
class Poses {
 public:
  void tell(const std::string& viewer, const Camera& camera, std::int64_t now_ns) {
    flatbuffers::FlatBufferBuilder builder;
    const wire::Camera out = to_wire(camera);
    const auto header = wire::CreateHeaderDirect(builder, "", "");
    builder.Finish(wire::CreateViewerPoseDirect(builder, header, viewer.c_str(), &out));
    ASSERT_TRUE(poses.take(*flatbuffers::GetRoot<wire::ViewerPose>(builder.GetBufferPointer()), now_ns));
  }
  ViewerPoses poses;
};

/// Looks along -z.
inline Camera standing(const glm::vec3& eye) {
  return look_at(eye, eye + glm::vec3(0, 0, -1), 64, 64, 1);
}

/// Both rigs and an engine that answers at once, at times that the test sets.
class RigControlTest : public testing::Test {
 protected:
  RigControlTest() {
    set("input_cameras", "12");
    set("reference_cameras", "4");
    set("input_range_hz", "0");
    set("input_lead_s", "0");
    set("input_about", "0");
    set("reference_size", "64");
  }
  void set(const char* name, const char* value) { ASSERT_EQ(parameters_.set(name, value, true), ""); }

  /// All that came before is answered, unless it is said not to be.
  std::vector<Camera> update(bool answer = true) {
    told_.poses.expire(now_ns_);
    auto left = control_.update(told_.poses, now_ns_);
    if (answer) answer_all();
    return left;
  }
  void answer_all() {
    for (const CameraRequest& request : control_.cameras().requests()) {
      if (request.camera.role == CameraRole::Reference) control_.references().arrived(request.camera.id);
      if (request.camera.role != CameraRole::Input) continue;
      InputRig* const rig = control_.inputs().awaiting(request.camera.id, request.request_id);
      if (rig == nullptr) continue;
      control_.inputs().arrived(*rig, request.camera.id, request.request_id, std::make_shared<InputView>(), now_ns_);
    }
  }
  /// The picture of one input camera comes.
  void answer_input(std::uint32_t camera_id) {
    for (const CameraRequest& request : control_.cameras().of_role(CameraRole::Input)) {
      InputRig* const rig = control_.inputs().awaiting(request.camera.id, request.request_id);
      if (request.camera.id != camera_id || rig == nullptr) continue;
      control_.inputs().arrived(*rig, camera_id, request.request_id, std::make_shared<InputView>(), now_ns_);
    }
  }
  /// The input picture that has been waited for longest comes. Returns its request's id; 0 where none is waited for.
  std::uint64_t answer_oldest_input() {
    std::optional<CameraRequest> oldest;
    for (const CameraRequest& request : control_.cameras().of_role(CameraRole::Input)) {
      InputRig* const rig = control_.inputs().awaiting(request.camera.id, request.request_id);
      if (rig == nullptr || answered_.contains(request.request_id)) continue;
      if (!oldest || request.request_id < oldest->request_id) oldest = request;
    }
    if (!oldest) return 0;
    InputRig* const rig = control_.inputs().awaiting(oldest->camera.id, oldest->request_id);
    control_.inputs().arrived(*rig, oldest->camera.id, oldest->request_id, std::make_shared<InputView>(), now_ns_);
    answered_.insert(oldest->request_id);
    return oldest->request_id;
  }
  /// Every face of each depth cube that is asked for shows surfaces at that distance. Returns how many faces.
  int answer_cubes(float depth_m) {
    int faces = 0;
    for (const CameraRequest& request : control_.cameras().of_role(CameraRole::Probe)) {
      const Camera* const camera = control_.ranges().awaited(request.camera.id, request.request_id);
      if (camera == nullptr) continue;
      std::vector<float> depth(std::size_t{camera->width} * camera->height, depth_m);
      control_.ranges().take(request.camera.id, std::move(depth), now_ns_, control_.cameras());
      ++faces;
    }
    return faces;
  }
  void look(const std::string& viewer, const Camera& camera) { told_.tell(viewer, camera, now_ns_); }
  void pass(std::int64_t ns) { now_ns_ += ns; }

  [[nodiscard]] std::vector<Camera> of(CameraRole role) {
    std::vector<Camera> cameras;
    for (const CameraRequest& request : control_.cameras().of_role(role)) cameras.push_back(request.camera);
    return cameras;
  }
  /// How many stand that near to a place; all ids of the role are different.
  [[nodiscard]] int about(CameraRole role, const glm::vec3& place, float metres) {
    int count = 0;
    std::set<std::uint32_t> ids;
    for (const Camera& camera : of(role)) {
      count += glm::distance(camera.world_from_camera.translation, place) < metres ? 1 : 0;
      EXPECT_TRUE(ids.insert(camera.id).second) << camera.id;
    }
    return count;
  }
  [[nodiscard]] InputRig& rig(const std::string& viewer) { return control_.inputs().all().at(viewer); }

  bus::Parameters parameters_{bus::Parameters::declare<Options>()};
  RigControl control_{parameters_, 1000};
  Poses told_;
  std::int64_t now_ns_ = kSecond;
  float walked_m_ = 0;
  std::set<std::uint64_t> answered_;  ///< requests, by answer_oldest_input()
};

}  // namespace splatbus::capture_bridge::test
