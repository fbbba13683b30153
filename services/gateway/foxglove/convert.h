#pragma once

#include <cstdint>
#include <opencv2/core.hpp>
#include <string>
#include <string_view>
#include <vector>

#include "gateway/foxglove/protocol.h"
#include "gaussians/camera.h"
#include "gaussians/light.h"

namespace splatbus::gateway::foxglove {

// Messages of Foxglove's own schemas (schemas/foxglove), as FlatBuffers. Times: nanoseconds since 1970, UTC.

/// The frame of everything: metres, right-handed, y up.
inline constexpr std::string_view kWorld = "world";
/// The same with z up, as Foxglove's 3D panel draws it: what the world hangs under.
inline constexpr std::string_view kMap = "map";

struct FrameTransform {
  std::string parent, child;
  Rigid parent_from_child;
};
[[nodiscard]] Payload frame_transforms(const std::vector<FrameTransform>& transforms, std::uint64_t time_ns);

/// map_from_world.
[[nodiscard]] FrameTransform world_in_map();
/// world_from_object of each, without its scale, for which the schema has no room.
[[nodiscard]] std::vector<FrameTransform> object_frames(const ObjectTransforms& objects);
[[nodiscard]] std::string object_frame(std::uint32_t id);
/// "reference-3".
[[nodiscard]] std::string camera_name(const Camera& camera);
[[nodiscard]] std::string camera_frame(std::string_view name);

/// Its pixel centres are at whole numbers, as OpenCV has them, and not at +0.5 as ours.
[[nodiscard]] Payload camera_calibration(const Camera& camera, const std::string& frame, std::uint64_t time_ns);

/// `bgr`: CV_8UC3. As JPEG or as PNG. Throws std::runtime_error when it cannot be encoded.
[[nodiscard]] Payload compressed_image(const cv::Mat& bgr, bool png, const std::string& frame, std::uint64_t time_ns);

/// RawImage. `metres`: of each pixel, CV_32FC1, along the camera's z.
[[nodiscard]] Payload depth_image(const cv::Mat& metres, const std::string& frame, std::uint64_t time_ns);

/// `level`: Foxglove's number.
[[nodiscard]] Payload log_line(std::uint8_t level, const std::string& source, const std::string& text,
                               std::uint64_t time_ns);

/// `points`: as sample_points() gives them, in the world's frame.
[[nodiscard]] Payload point_cloud(const std::string& points, std::uint64_t time_ns);

}  // namespace splatbus::gateway::foxglove
