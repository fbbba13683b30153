#include "splats/baked_model.h"

#include <gtest/gtest.h>

#include <cmath>

#include "../gaussians/random.h"
#include "gaussians/sh.h"
#include "gaussians/transfer.h"

namespace splatbus::splats {
namespace {

/// load() reads no appearance of a Transfer model with this.
GaussiansView geometry(const GaussiansBuffer& model) {
  GaussiansView view = model.view();
  if (view.layout.appearance == Appearance::Transfer) view.layout = {Appearance::Radiance, 0};
  return view;
}

/// Those of objects that the scene has, in order.
std::vector<std::size_t> shown(const GaussiansBuffer& model, const SceneState& scene) {
  std::vector<std::size_t> indices;
  for (std::size_t i = 0; i < model.count(); ++i) {
    if (model.object_id[i] == kWorldFrame || scene.objects.contains(model.object_id[i])) indices.push_back(i);
  }
  return indices;
}

TEST(BakedModel, MovesObjectsIntoTheWorldAndHidesThoseThatAreGone) {
  test::Random random(14);
  const GaussiansBuffer model = random.gaussians({Appearance::Radiance, 3}, 40);
  SceneState scene;
  scene.objects = {{1, random.rigid()}, {3, random.rigid()}};
  scene.objects.at(3).scale = 2;
  const BakedModel baked(model.view(), scene);
  const auto indices = shown(model, scene);
  ASSERT_EQ(baked.count(), indices.size());
  ASSERT_LT(baked.count(), model.count());
  EXPECT_EQ(baked.sh_degree(), 3);
  for (std::size_t i = 0; i < indices.size(); ++i) {
    const Splat before = load(model.view(), indices[i]), after = baked[i];
    const auto found = scene.objects.find(model.object_id[indices[i]]);
    const ObjectTransform world_from_object = found == scene.objects.end() ? ObjectTransform{} : found->second;
    EXPECT_LE(glm::distance(after.mean, world_from_object.rigid.rotation * before.mean * world_from_object.scale +
                                            world_from_object.rigid.translation),
              1e-5F);
    for (int axis = 0; axis < 3; ++axis) {
      EXPECT_NEAR(std::exp(after.log_scale[axis] - before.log_scale[axis]), world_from_object.scale, 1e-5F);
    }
    EXPECT_NEAR(std::abs(glm::dot(after.rotation, world_from_object.rigid.rotation * before.rotation)), 1, 1e-6F);
    // The same radiance leaves in the same direction.
    const glm::vec3 d = random.direction();
    const Sh16 world = sh16_basis(d), local = sh16_basis(glm::conjugate(world_from_object.rigid.rotation) * d);
    glm::vec3 seen(0), expected(0);
    for (std::size_t k = 0; k < 16; ++k) {
      seen += world[k] * after.sh[k];
      expected += local[k] * before.sh[k];
    }
    EXPECT_LE(glm::distance(seen, expected), 4e-5F);
  }
}

TEST(BakedModel, ShadesTransferUnderTheLight) {
  test::Random random(15);
  GaussiansBuffer model = random.gaussians({Appearance::Transfer, 3}, 60);
  for (float& value : model.parameters) value *= 0.5F;
  SceneState scene;
  scene.light = random.light();
  scene.objects = {{2, random.rigid()}};
  const BakedModel baked(model.view(), scene);
  EXPECT_EQ(baked.sh_degree(), 0);
  const auto indices = shown(model, scene);
  ASSERT_EQ(baked.count(), indices.size());
  for (std::size_t i = 0; i < indices.size(); ++i) {
    const bool moved = model.object_id[indices[i]] == 2;
    const glm::quat world_from_object = moved ? scene.objects.at(2).rigid.rotation : glm::quat(1, 0, 0, 0);
    const Light local = light_in_object(scene.light, Rigid{.rotation = world_from_object, .translation = {}});
    const glm::vec3 linear = shade_transfer(model.view(), indices[i], local);
    const Splat splat = baked[i];
    EXPECT_LE(glm::distance(splat.normal, world_from_object * load(geometry(model), indices[i]).normal), 1e-5F);
    for (int c = 0; c < 3; ++c) {
      // What another tool shows: 0.5 + C0 f_dc, display space.
      EXPECT_NEAR(0.5F + kShC0 * splat.sh[0][c], srgb_from_linear(linear[c]), 1e-5F);
    }
  }
}

TEST(BakedModel, HasTheFarFieldAboutTheOrigin) {
  test::Random random(16);
  GaussiansBuffer model = random.gaussians({Appearance::Transfer, 3}, 1);
  model.object_id[0] = kFarFieldFrame;
  for (int axis = 0; axis < 3; ++axis) {
    model.parameters[static_cast<std::size_t>(axis)] = kFarFieldCentre[axis] + (axis == 0 ? kFarFieldRadius : 0);
  }
  const Splat splat = BakedModel(model.view(), {})[0];
  EXPECT_NEAR(glm::length(splat.mean), kFarFieldDistance_m, 0.01F);
}

TEST(BakedModel, LeavesOutWhatIsNotFinite) {
  test::Random random(18);
  GaussiansBuffer model = random.gaussians({Appearance::Transfer, 3}, 6);
  model.object_id.assign(6, kWorldFrame);
  const std::size_t stride = model.stride();
  model.parameters[0] = std::nanf("");                                        // x of Gaussian 0
  model.parameters[30 * stride + 1] = INFINITY;                               // a residual of Gaussian 1
  model.normal[stride + 2] = std::nanf("");                                   // a normal of Gaussian 2
  model.visibility[3] = std::nanf("");                                        //
  for (std::size_t k = 6; k < 10; ++k) model.parameters[k * stride + 4] = 0;  // no rotation
  const BakedModel baked(model.view(), {});
  ASSERT_EQ(baked.count(), 1U);
  EXPECT_EQ(baked[0].mean, load(geometry(model), 5).mean);
}

}  // namespace
}  // namespace splatbus::splats
