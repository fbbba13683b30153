// What is made of our types in Foxglove's schemas, and the schemas themselves.
#include <flatbuffers/reflection_generated.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>
#include <numbers>
#include <opencv2/imgcodecs.hpp>

#include "../../stream/toy_model.h"
#include "foxglove/CameraCalibration_generated.h"
#include "foxglove/CompressedImage_generated.h"
#include "foxglove/FrameTransforms_generated.h"
#include "foxglove/PointCloud_generated.h"
#include "gateway/foxglove/convert.h"
#include "gateway/foxglove/point_sample.h"
#include "wire/schemas.h"

namespace splatbus::gateway::foxglove {
namespace {

namespace theirs = ::foxglove;

template <class Table>
const Table& read(const Payload& payload) {
  flatbuffers::Verifier verifier(reinterpret_cast<const std::uint8_t*>(payload->data()), payload->size());
  EXPECT_TRUE(verifier.VerifyBuffer<Table>(nullptr));
  return *flatbuffers::GetRoot<Table>(payload->data());
}

/// As Foxglove's documentation has it: p_parent = rotation * p_child + translation.
glm::dvec3 to_parent(const theirs::FrameTransform& transform, const glm::dvec3& point) {
  const auto* q = transform.rotation();
  const auto* t = transform.translation();
  return glm::dquat(q->w(), q->x(), q->y(), q->z()) * point + glm::dvec3(t->x(), t->y(), t->z());
}

TEST(FoxgloveViews, AFrameIsWhereItsPointsAre) {
  // A quarter turn about y, which takes z to x.
  const Rigid rigid{.rotation = glm::angleAxis(std::numbers::pi_v<float> / 2, glm::vec3(0, 1, 0)),
                    .translation = {10, 20, 30}};
  const Payload payload = frame_transforms({{"world", "object/7", rigid}}, 5'000'000'123);
  const auto& transforms = *read<theirs::FrameTransforms>(payload).transforms();
  ASSERT_EQ(transforms.size(), 1U);
  EXPECT_EQ(transforms[0]->parent_frame_id()->str(), "world");
  EXPECT_EQ(transforms[0]->child_frame_id()->str(), "object/7");
  EXPECT_EQ(transforms[0]->timestamp()->sec(), 5U);
  EXPECT_EQ(transforms[0]->timestamp()->nsec(), 123U);
  const glm::dvec3 moved = to_parent(*transforms[0], {0, 0, 2});
  EXPECT_NEAR(glm::length(moved - glm::dvec3(12, 20, 30)), 0, 1e-5);
}

TEST(FoxgloveViews, TheMapHasZUpAndIsRightHanded) {
  const Payload payload = frame_transforms({world_in_map()}, 0);
  const auto& transform = *(*read<theirs::FrameTransforms>(payload).transforms())[0];
  const glm::dvec3 x = to_parent(transform, {1, 0, 0}), y = to_parent(transform, {0, 1, 0}),
                   z = to_parent(transform, {0, 0, 1});
  EXPECT_NEAR(glm::length(y - glm::dvec3(0, 0, 1)), 0, 1e-6) << "up";
  EXPECT_NEAR(glm::length(glm::cross(x, y) - z), 0, 1e-6);
}

TEST(FoxgloveViews, ACalibrationProjectsAsTheCameraDoes) {
  const Camera camera = look_at({1, 2, 5}, {0, 0.5F, 0}, 640, 360, 0.9F);
  const Payload payload = camera_calibration(camera, "camera/x", 0);
  const auto& calibration = read<theirs::CameraCalibration>(payload);
  EXPECT_EQ(calibration.width(), 640U);
  EXPECT_EQ(calibration.height(), 360U);
  const glm::vec3 point(0.3F, 0.8F, -0.4F);
  const glm::vec3 expected = project(camera, point);
  const glm::dvec3 seen = inverse(camera.world_from_camera) * point;
  double uvw[3] = {0, 0, 0};
  const double homogeneous[4] = {seen.x, seen.y, seen.z, 1};
  for (unsigned row = 0; row < 3; ++row) {
    for (unsigned column = 0; column < 4; ++column)
      uvw[row] += (*calibration.p())[row * 4 + column] * homogeneous[column];
  }
  // Where our first pixel's centre is 0.5, theirs is 0.
  EXPECT_NEAR(uvw[0] / uvw[2], expected.x - 0.5, 1e-3);
  EXPECT_NEAR(uvw[1] / uvw[2], expected.y - 0.5, 1e-3);
  EXPECT_EQ((*calibration.k())[8], 1);
  EXPECT_EQ((*calibration.k())[2], (*calibration.p())[2]);
}

TEST(FoxgloveViews, APictureIsDecodedAsItWas) {
  cv::Mat picture(48, 64, CV_8UC3, cv::Scalar(200, 100, 30));
  picture.rowRange(0, 24).setTo(cv::Scalar(20, 40, 220));
  for (const bool png : {false, true}) {
    const Payload payload = compressed_image(picture, png, "camera/x", 0);
    const auto& image = read<theirs::CompressedImage>(payload);
    EXPECT_EQ(image.format()->str(), png ? "png" : "jpeg");
    const cv::Mat decoded =
        cv::imdecode(std::vector<std::uint8_t>(image.data()->begin(), image.data()->end()), cv::IMREAD_COLOR);
    ASSERT_EQ(decoded.size(), picture.size());
    EXPECT_LE(cv::norm(decoded, picture, cv::NORM_INF), png ? 0 : 64);
    for (const int row : {8, 40}) {
      for (int c = 0; c < 3; ++c) EXPECT_NEAR(decoded.at<cv::Vec3b>(row, 32)[c], picture.at<cv::Vec3b>(row, 32)[c], 6);
    }
  }
}

struct Point {
  float x, y, z;
  std::uint8_t red, green, blue, alpha;
};

std::vector<Point> points_of(const std::string& bytes) {
  std::vector<Point> points(bytes.size() / sizeof(Point));
  std::memcpy(points.data(), bytes.data(), points.size() * sizeof(Point));
  return points;
}

TEST(FoxgloveViews, PointsAreTheGaussiansInTheWorldsFrame) {
  const GaussiansBuffer model = stream::test::toy_model(100, 1, 1, Appearance::Radiance);
  SceneState scene;
  scene.objects[7] = Rigid{.rotation = glm::angleAxis(0.5F, glm::vec3(0, 1, 0)), .translation = {5, 0, 0}};
  const auto points = points_of(sample_points(model.view(), scene, 1000));
  ASSERT_EQ(points.size(), 100U);
  for (std::size_t i = 0; i < points.size(); ++i) {
    const auto value = [&](int channel) {
      return model.parameters[static_cast<std::size_t>(channel) * model.stride() + i];
    };
    glm::vec3 expected(value(0), value(1), value(2));
    if (model.object_id[i] == 7) expected = scene.objects.at(7) * expected;
    EXPECT_NEAR(glm::length(glm::vec3(points[i].x, points[i].y, points[i].z) - expected), 0, 1e-5);
    EXPECT_NEAR(points[i].alpha, 255 / (1 + std::exp(-value(10))), 0.51);
    // 3DGS: 0.5 + the first coefficient times its basis, the same from all sides.
    EXPECT_NEAR(points[i].green, 255 * std::clamp(0.5F + 0.28209479F * value(12), 0.0F, 1.0F), 0.51);
  }
}

TEST(FoxgloveViews, OfManyGaussiansSomeAreTaken) {
  const GaussiansBuffer model = stream::test::toy_model(1000, 1);
  const SceneState scene;
  const auto all = points_of(sample_points(model.view(), scene, 1000));
  const auto some = points_of(sample_points(model.view(), scene, 300));
  EXPECT_LE(some.size(), 300U);
  EXPECT_GE(all.size(), 600U) << "object 7 is hidden";
  EXPECT_GE(some.size(), all.size() / 5);
  EXPECT_EQ(sample_points(model.view(), scene, 0).size(), 0U);
}

TEST(FoxgloveViews, ACloudSaysWhereItsFieldsLie) {
  const std::string bytes(3 * kPointBytes, 'x');
  const Payload payload = point_cloud(bytes, 0);
  const auto& cloud = read<theirs::PointCloud>(payload);
  EXPECT_EQ(cloud.frame_id()->str(), "world");
  EXPECT_EQ(cloud.point_stride(), sizeof(Point));
  EXPECT_EQ(cloud.data()->size(), bytes.size());
  EXPECT_EQ(cloud.pose()->orientation()->w(), 1);
  std::vector<std::pair<std::string, std::uint32_t>> fields;
  for (const auto* field : *cloud.fields()) fields.emplace_back(field->name()->str(), field->offset());
  EXPECT_THAT(fields, testing::ElementsAre(
                          testing::Pair("x", offsetof(Point, x)), testing::Pair("y", offsetof(Point, y)),
                          testing::Pair("z", offsetof(Point, z)), testing::Pair("red", offsetof(Point, red)),
                          testing::Pair("green", offsetof(Point, green)), testing::Pair("blue", offsetof(Point, blue)),
                          testing::Pair("alpha", offsetof(Point, alpha))));
}

TEST(Schemas, EveryTableOfTheBusHasOneWithItsHeaderFirst) {
  for (const char* name : {"CaptureInput/3", "CaptureReference/3", "EngineFrame/3", "ModelPublished/3", "Heartbeat/1",
                           "StreamStats/2", "TrainerStats/2", "ViewerPose/1", "SceneUpdate/1"}) {
    const auto schema = wire::find_schema(name);
    ASSERT_TRUE(schema) << name;
    flatbuffers::Verifier verifier(schema->binary.data(), schema->binary.size());
    ASSERT_TRUE(reflection::VerifySchemaBuffer(verifier)) << name;
    const auto* table = reflection::GetSchema(schema->binary.data())->objects()->LookupByKey(schema->table.data());
    ASSERT_NE(table, nullptr) << name;
    const auto* header = table->fields()->LookupByKey("header");
    ASSERT_NE(header, nullptr);
    EXPECT_EQ(header->id(), 0);
  }
  EXPECT_FALSE(wire::find_schema("Heartbeat/2")) << "of another version";
  EXPECT_FALSE(wire::find_schema("Header/1")) << "no root";
  EXPECT_FALSE(wire::find_schema(""));
  EXPECT_THROW((void)wire::foxglove_schema("foxglove.Nothing"), std::out_of_range);
}

}  // namespace
}  // namespace splatbus::gateway::foxglove
