#include "gateway/foxglove/convert.h"

#include <fmt/format.h>
#include <stb_image_write.h>

#include <cmath>
#include <opencv2/imgproc.hpp>
#include <stdexcept>

#include "foxglove/CameraCalibration_generated.h"
#include "foxglove/CompressedImage_generated.h"
#include "foxglove/FrameTransforms_generated.h"
#include "foxglove/Log_generated.h"
#include "foxglove/PointCloud_generated.h"
#include "foxglove/RawImage_generated.h"
#include "gateway/foxglove/point_sample.h"
#include "metrics/image_io.h"

namespace splatbus::gateway::foxglove {

namespace {

namespace theirs = ::foxglove;

constexpr int kJpegQuality = 90;

theirs::Time time_of(std::uint64_t ns) {
  return {static_cast<std::uint32_t>(ns / 1'000'000'000), static_cast<std::uint32_t>(ns % 1'000'000'000)};
}

template <class Table>
Payload finish(flatbuffers::FlatBufferBuilder& builder, flatbuffers::Offset<Table> root) {
  builder.Finish(root);
  return std::make_shared<const std::string>(reinterpret_cast<const char*>(builder.GetBufferPointer()),
                                             builder.GetSize());
}

std::vector<std::uint8_t> encode_jpeg(const cv::Mat& bgr) {
  cv::Mat rgb;
  cv::cvtColor(bgr, rgb, cv::COLOR_BGR2RGB);
  std::vector<std::uint8_t> file;
  const auto append = [](void* to, void* data, int bytes) {
    const auto* first = static_cast<const std::uint8_t*>(data);
    auto& out = *static_cast<std::vector<std::uint8_t>*>(to);
    out.insert(out.end(), first, first + bytes);
  };
  if (stbi_write_jpg_to_func(append, &file, rgb.cols, rgb.rows, 3, rgb.data, kJpegQuality) == 0) {
    throw std::runtime_error("a picture could not be encoded");
  }
  return file;
}

}  // namespace

Payload frame_transforms(const std::vector<FrameTransform>& transforms, std::uint64_t time_ns) {
  flatbuffers::FlatBufferBuilder builder;
  const theirs::Time time = time_of(time_ns);
  std::vector<flatbuffers::Offset<theirs::FrameTransform>> offsets;
  offsets.reserve(transforms.size());
  for (const auto& [parent, child, rigid] : transforms) {
    const auto& [p, q] = std::pair(rigid.translation, rigid.rotation);
    const auto translation = theirs::CreateVector3(builder, p.x, p.y, p.z);
    const auto rotation = theirs::CreateQuaternion(builder, q.x, q.y, q.z, q.w);
    offsets.push_back(
        theirs::CreateFrameTransformDirect(builder, &time, parent.c_str(), child.c_str(), translation, rotation));
  }
  return finish(builder, theirs::CreateFrameTransformsDirect(builder, &offsets));
}

FrameTransform world_in_map() {
  const float half = std::sqrt(0.5F);
  return {std::string(kMap), std::string(kWorld), {.rotation = {half, half, 0, 0}, .translation = {}}};
}

std::vector<FrameTransform> object_frames(const ObjectTransforms& objects) {
  std::vector<FrameTransform> frames;
  frames.reserve(objects.size());
  for (const auto& [id, world_from_object] : objects) {
    frames.push_back({std::string(kWorld), object_frame(id), world_from_object.rigid});
  }
  return frames;
}

std::string object_frame(std::uint32_t id) {
  return fmt::format("object/{}", id);
}

std::string camera_name(const Camera& camera) {
  const char* role = camera.role == CameraRole::Input       ? "input"
                     : camera.role == CameraRole::Reference ? "reference"
                     : camera.role == CameraRole::Probe     ? "probe"
                                                            : "light";
  return fmt::format("{}-{}", role, camera.id);
}

std::string camera_frame(std::string_view name) {
  return fmt::format("camera/{}", name);
}

Payload camera_calibration(const Camera& camera, const std::string& frame, std::uint64_t time_ns) {
  flatbuffers::FlatBufferBuilder builder;
  const theirs::Time time = time_of(time_ns);
  const double fx = camera.fx, fy = camera.fy, cx = camera.cx - 0.5, cy = camera.cy - 0.5;
  const std::vector<double> d(5, 0.0), k{fx, 0, cx, 0, fy, cy, 0, 0, 1}, r{1, 0, 0, 0, 1, 0, 0, 0, 1},
      p{fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0};
  return finish(builder, theirs::CreateCameraCalibrationDirect(builder, &time, frame.c_str(), camera.width,
                                                               camera.height, "plumb_bob", &d, &k, &r, &p));
}

Payload compressed_image(const cv::Mat& bgr, bool png, const std::string& frame, std::uint64_t time_ns) {
  const std::vector<std::uint8_t> file = png ? metrics::encode_png(bgr) : encode_jpeg(bgr);
  flatbuffers::FlatBufferBuilder builder(file.size() + 256);
  const theirs::Time time = time_of(time_ns);
  return finish(builder,
                theirs::CreateCompressedImageDirect(builder, &time, frame.c_str(), &file, png ? "png" : "jpeg"));
}

Payload depth_image(const cv::Mat& metres, const std::string& frame, std::uint64_t time_ns) {
  const auto width = static_cast<std::uint32_t>(metres.cols), height = static_cast<std::uint32_t>(metres.rows);
  const std::uint32_t step = width * static_cast<std::uint32_t>(sizeof(float));
  flatbuffers::FlatBufferBuilder builder(std::size_t{step} * height + 256);
  const theirs::Time time = time_of(time_ns);
  const auto frame_at = builder.CreateString(frame);
  const auto encoding = builder.CreateString("32FC1");
  const auto data = builder.CreateVector(metres.data, std::size_t{step} * height);
  return finish(builder, theirs::CreateRawImage(builder, &time, frame_at, width, height, encoding, step, data));
}

Payload log_line(std::uint8_t level, const std::string& source, const std::string& text, std::uint64_t time_ns) {
  flatbuffers::FlatBufferBuilder builder;
  const theirs::Time time = time_of(time_ns);
  return finish(builder, theirs::CreateLogDirect(builder, &time, static_cast<theirs::LogLevel>(level), text.c_str(),
                                                 source.c_str()));
}

Payload point_cloud(const std::string& points, std::uint64_t time_ns) {
  using theirs::NumericType;
  flatbuffers::FlatBufferBuilder builder(points.size() + 1024);
  const theirs::Time time = time_of(time_ns);
  const auto pose = theirs::CreatePose(builder, theirs::CreateVector3(builder), theirs::CreateQuaternion(builder));
  std::vector<flatbuffers::Offset<theirs::PackedElementField>> fields;
  std::uint32_t offset = 0;
  for (const char* name : {"x", "y", "z"}) {
    fields.push_back(theirs::CreatePackedElementFieldDirect(builder, name, offset, NumericType::FLOAT32));
    offset += sizeof(float);
  }
  for (const char* name : {"red", "green", "blue", "alpha"}) {
    fields.push_back(theirs::CreatePackedElementFieldDirect(builder, name, offset++, NumericType::UINT8));
  }
  const auto frame = builder.CreateString(std::string(kWorld));
  const auto field_vector = builder.CreateVector(fields);
  const auto data = builder.CreateVector(reinterpret_cast<const std::uint8_t*>(points.data()), points.size());
  return finish(builder, theirs::CreatePointCloud(builder, &time, frame, pose, kPointBytes, field_vector, data));
}

}  // namespace splatbus::gateway::foxglove
