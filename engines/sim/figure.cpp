#include "sim/figure.h"

#include <algorithm>
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <glm/gtc/matrix_transform.hpp>
#include <string>
#include <utility>

#include "sim/patterns.h"

namespace splatbus::sim {
namespace {

constexpr glm::vec3 kRight{1, 0, 0};

// The body, in metres. Its frame: x right, y up, looking along -z, on the floor under the hips.
constexpr float kLimb_m = 0.165F;  // thigh, and shin
constexpr float kAnkle_m = 0.04F;  // above the sole
constexpr float kHip_m = 0.352F, kBob_m = 0.006F;
constexpr float kHipApart_m = 0.055F, kShoulderApart_m = 0.115F;
constexpr glm::vec3 kNeck{0, 0.225F, 0};  // in the torso's frame
constexpr float kShoulder_m = 0.19F;      // above the hips
constexpr float kReach_m = 0.2F;          // no joint is farther from the body's axis

// The walk.
constexpr float kRadius_m = 2.05F;
constexpr double kSpeed_m_s = 0.4;
constexpr float kHalfStep_m = 0.11F;  // how far before and behind the hips a foot carries
constexpr double kCarries = 0.6;      // of a cycle
constexpr double kCycle_s = 2 * kHalfStep_m / (kCarries * kSpeed_m_s);
constexpr float kLift_m = 0.05F;

float wave(double cycles) {
  return std::cos(static_cast<float>(2 * glm::pi<double>() * (cycles - std::floor(cycles))));
}

/// About the body's right, forwards for what hangs.
Pose swung(float radians, const glm::vec3& joint) {
  return {glm::angleAxis(radians, kRight), joint};
}

struct Step {
  float forward_m, lift_m, toe_up;  ///< of the ankle before the hips and above its rest; radians
};

/// Carrying, the foot stays where it is on the floor while the body passes over it; then it swings to the front.
Step step_at(double cycles, float half_step_m) {
  const double phase = cycles - std::floor(cycles);
  if (phase < kCarries) return {half_step_m * static_cast<float>(1 - 2 * phase / kCarries), 0, 0};
  const auto swing = static_cast<float>((phase - kCarries) / (1 - kCarries)) * glm::pi<float>();
  return {-half_step_m * std::cos(swing), kLift_m * std::sin(swing), -0.35F * std::sin(2 * swing)};
}

struct LegPose {
  Pose thigh, shin, foot;
};

/// Thigh and shin are of one length: they bend by the same angle about the line from hip to ankle.
LegPose leg_at(double cycles, float side, float hip_m) {
  // On a circle the outer leg takes longer steps.
  const Step step = step_at(cycles, kHalfStep_m * (1 + side * kHipApart_m / kRadius_m));
  const glm::vec3 hip{side * kHipApart_m, hip_m, 0};
  const glm::vec3 ankle{hip.x, kAnkle_m + step.lift_m, -step.forward_m};
  const float lean = std::atan2(step.forward_m, hip.y - ankle.y);
  const float bend = std::acos(std::min(glm::distance(hip, ankle) / (2 * kLimb_m), 1.0F));
  const Pose thigh = swung(lean + bend, hip);
  const glm::vec3 knee = hip + thigh.rotation * glm::vec3{0, -kLimb_m, 0};
  return {thigh, swung(lean - bend, knee), swung(step.toe_up, ankle)};
}

Mesh limb(float radius, float length) {
  Mesh mesh;
  append(mesh, capsule(radius, length, 20, 2), glm::translate(glm::mat4(1), {0, -length / 2, 0}));
  return mesh;
}

Mesh head() {
  constexpr float kHead_m = 0.085F;
  Mesh mesh;
  append(mesh, sphere(kHead_m, 28), glm::translate(glm::mat4(1), {0, 0.095F, 0}));
  append(mesh, sphere(0.018F, 12), glm::translate(glm::mat4(1), {0, 0.09F, -kHead_m}));
  append(mesh, cone(0.095F, 0.11F, 24, 2), glm::translate(glm::mat4(1), {0, 0.135F, 0}));
  return mesh;
}

Mesh torso() {
  return lathe(std::array<glm::vec2, 8>{{{0, -0.04F},
                                         {0.075F, -0.03F},
                                         {0.085F, 0.02F},
                                         {0.075F, 0.08F},
                                         {0.095F, 0.16F},
                                         {0.075F, 0.205F},
                                         {0.03F, 0.22F},
                                         {0, 0.235F}}},
               28, 2);
}

/// Bent at the elbow, with a hand.
Mesh arm() {
  constexpr float kUpper_m = 0.1F, kFore_m = 0.085F, kThick_m = 0.026F;
  Mesh mesh = limb(kThick_m, kUpper_m);
  const glm::mat4 elbow = glm::rotate(glm::translate(glm::mat4(1), {0, -kUpper_m, 0}), 0.5F, kRight);
  append(mesh, limb(0.9F * kThick_m, kFore_m), elbow);
  append(mesh, sphere(0.033F, 16), glm::translate(elbow, {0, -kFore_m - 0.015F, 0}));
  return mesh;
}

Mesh shoe() {
  Mesh mesh;
  append(mesh, sphere(1, 20, 2),
         glm::scale(glm::translate(glm::mat4(1), {0, 0, -0.03F}), glm::vec3{0.038F, kAnkle_m, 0.078F}));
  return mesh;
}

/// On the floor under the hips, x right, y up.
Pose body_at(double time_s) {
  const double around = std::remainder(time_s * kSpeed_m_s / kRadius_m, 2 * glm::pi<double>());
  const glm::quat heading = glm::angleAxis(static_cast<float>(around), kUp);
  return {heading, heading * glm::vec3{kRadius_m, 0, 0}};
}

}  // namespace

Pose figure_camera_at(double time_s) {
  constexpr glm::vec3 kBehind{0, 0.85F, 0.9F};
  constexpr float kDown = 0.3F, kInwards = 0.45F;  // radians: ahead, and where the toys are
  const glm::quat about = glm::angleAxis(kInwards, kUp) * glm::angleAxis(glm::pi<float>() - kDown, kRight);
  return body_at(time_s) * Pose{about, kBehind};
}

std::array<Pose, kBones> figure_at(double time_s) {
  const double cycles = time_s / kCycle_s;
  const Pose body = body_at(time_s);

  // Lowest when both feet carry, half way apart; the shoulders turn against the legs.
  const float hip_m = kHip_m + kBob_m * wave(2 * (cycles - kCarries / 2));
  const LegPose right = leg_at(cycles, 1, hip_m);
  const LegPose left = leg_at(cycles + 0.5, -1, hip_m);
  const float stride = wave(cycles - kCarries / 2 + 0.25);
  const Pose torso{glm::angleAxis(-0.16F * stride, kUp) * glm::angleAxis(-0.07F, kRight), {0, hip_m, 0}};
  const auto arm = [&](float side) {
    return torso * swung(-0.55F * side * stride, {side * kShoulderApart_m, kShoulder_m, 0});
  };
  const Pose look{glm::angleAxis(0.35F * wave(time_s / 7), kUp), (torso * Pose{.translation = kNeck}).translation};

  std::array<Pose, kBones> bones{torso,      look,       arm(1),    arm(-1),    right.thigh,
                                 left.thigh, right.shin, left.shin, right.foot, left.foot};
  for (Pose& bone : bones) bone = body * bone;
  return bones;
}

void add_figure(Scene& scene) {
  const auto add = [&](Bone bone, const char* name, Mesh mesh, Image image, float low_m, float high_m) {
    Object& object = scene.add(std::string("figure ") + name, std::move(mesh), std::move(image));
    constexpr float kOut_m = kRadius_m + kReach_m;
    object.motion_origins.add({-kOut_m, low_m, -kOut_m});
    object.motion_origins.add({kOut_m, high_m, kOut_m});
    object.motion = [bone](double time_s) { return figure_at(time_s)[static_cast<std::size_t>(bone)]; };
  };
  const auto sleeve = [](const char* ground) {
    return stripes(std::array{color(ground), color("#f0e7d2"), color("#2f3f63")}, 3, true);
  };
  const auto leg = [](const char* ground) { return checker(6, color(ground), color("#e4d6b4")); };
  constexpr float kHigh_m = kHip_m + kBob_m;
  add(Bone::Torso, "torso", torso(), dots(6, color("#d0572f"), color("#f4e3b0"), 0.28F), kHip_m - kBob_m, kHigh_m);
  add(Bone::Head, "head", head(), stripes(std::array{color("#e2b48c"), color("#7b4bb0"), color("#f2d34e")}, 2, true),
      kHip_m, kHigh_m + kNeck.y);
  add(Bone::RightArm, "right arm", arm(), sleeve("#c23b4e"), kHip_m, kHigh_m + kShoulder_m);
  add(Bone::LeftArm, "left arm", arm(), sleeve("#3b7fc2"), kHip_m, kHigh_m + kShoulder_m);
  add(Bone::RightThigh, "right thigh", limb(0.038F, kLimb_m), leg("#3a5f9a"), kHip_m - kBob_m, kHigh_m);
  add(Bone::LeftThigh, "left thigh", limb(0.038F, kLimb_m), leg("#4a8a5a"), kHip_m - kBob_m, kHigh_m);
  add(Bone::RightShin, "right shin", limb(0.03F, kLimb_m), leg("#7fa3d8"), kHip_m - kBob_m - kLimb_m, kHigh_m);
  add(Bone::LeftShin, "left shin", limb(0.03F, kLimb_m), leg("#8fce9c"), kHip_m - kBob_m - kLimb_m, kHigh_m);
  const auto shoes = [] { return stripes(std::array{color("#2b2b33"), color("#d8b13a")}, 3, false); };
  add(Bone::RightFoot, "right foot", shoe(), shoes(), kAnkle_m, kAnkle_m + kLift_m);
  add(Bone::LeftFoot, "left foot", shoe(), shoes(), kAnkle_m, kAnkle_m + kLift_m);
}

void add_figure_camera(Scene& scene) {
  Object camera;
  camera.id = SPLATBUS_PLAYER_ID;
  camera.name = "figure camera";
  camera.motion = figure_camera_at;
  camera.casts_shadow = false;  // it is no thing that depth maps show
  camera.emissive = true;
  scene.objects.push_back(std::move(camera));
}

}  // namespace splatbus::sim
