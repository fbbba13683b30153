// The operations under torch.ops.splatbus and torch.classes.splatbus, for programs in Python: torch.ops.load_library()
// of libsplatbus_torch.so makes them known. docs/torch.md says how they are called.
#include "raster/torch/tensor.h"
// After it.
#include <torch/custom_class.h>
#include <torch/library.h>

#include <algorithm>
#include <cmath>
#include <exception>
#include <string>
#include <tuple>
#include <utility>

#include "raster/torch/checks.h"
#include "raster/torch/image_loss.h"
#include "raster/torch/rasterize.h"
#include "raster/torch/sparse_adam.h"

namespace splatbus::raster {
namespace {

using torch::Tensor;
// c10::optional or std::optional, as the version has it.
using OptionalTensor = decltype(std::declval<const c10::IValue&>().toOptional<Tensor>());

Tensor or_undefined(const OptionalTensor& tensor) {
  return tensor.value_or(Tensor());
}

glm::vec3 vector_of(at::ArrayRef<double> values, const char* name) {
  TORCH_CHECK(values.size() == 3, words("rasterize: ", name, " has ", values.size(), " values, 3 are needed"));
  return {static_cast<float>(values[0]), static_cast<float>(values[1]), static_cast<float>(values[2])};
}

/// Matrices [count, size, size] on the CPU, as doubles.
Tensor matrices_of(const Tensor& matrices, std::int64_t size, const char* name) {
  TORCH_CHECK(matrices.dim() == 3 && matrices.size(1) == size && matrices.size(2) == size,
              words("rasterize: ", name, " is ", matrices.sizes(), ", [count, ", size, ", ", size, "] is needed"));
  TORCH_CHECK(matrices.is_cpu(),
              words("rasterize: ", name, " is on ", matrices.device(), "; the host reads it: cpu is needed"));
  TORCH_CHECK(!matrices.requires_grad(),
              words("rasterize: ", name, " requires a gradient, and only parameters have one"));
  return matrices.to(at::kDouble).contiguous();
}

glm::dmat3 linear_of(const double* row_major) {
  glm::dmat3 linear;
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) linear[column][row] = row_major[4 * row + column];
  }
  return linear;
}

/// Of a 4x4 matrix of doubles, row by row, whose lengths are `scale` times as long.
Rigid rigid_of(const double* row_major, const char* name, double scale = 1) {
  const glm::dmat3 rotation = linear_of(row_major) / scale;
  const glm::dvec3 translation(row_major[3], row_major[7], row_major[11]);
  constexpr double kTolerance = 1e-3;
  const glm::dmat3 product = glm::transpose(rotation) * rotation;
  double error = std::abs(glm::determinant(rotation) - 1);
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) error = std::max(error, std::abs(product[i][k] - (i == k ? 1 : 0)));
  }
  TORCH_CHECK(error < kTolerance, words("rasterize: a matrix of ", name, " is not a rotation and a translation"));
  return {glm::quat(glm::normalize(glm::quat_cast(rotation))), glm::vec3(translation)};
}

std::vector<Camera> cameras_of(const Tensor& camera_from_world, const Tensor& intrinsics, std::int64_t width,
                               std::int64_t height) {
  const Tensor poses = matrices_of(camera_from_world, 4, "camera_from_world");
  const Tensor lenses = matrices_of(intrinsics, 3, "intrinsics");
  TORCH_CHECK(poses.size(0) == lenses.size(0), words("rasterize: ", poses.size(0), " matrices camera_from_world and ",
                                                     lenses.size(0), " of intrinsics"));
  constexpr std::int64_t kMaxSide = 1 << 15;
  TORCH_CHECK(width > 0 && height > 0 && width <= kMaxSide && height <= kMaxSide,
              words("rasterize: pictures of ", width, " x ", height, " pixels; a side has 1 to ", kMaxSide));
  std::vector<Camera> cameras(static_cast<std::size_t>(poses.size(0)));
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    const double* const lens = lenses.data_ptr<double>() + 9 * i;
    TORCH_CHECK(lens[1] == 0 && lens[3] == 0 && lens[6] == 0 && lens[7] == 0 && lens[8] == 1,
                words("rasterize: intrinsics ", i, " is not [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"));
    Camera& camera = cameras[i];
    camera.width = static_cast<std::uint32_t>(width);
    camera.height = static_cast<std::uint32_t>(height);
    camera.fx = static_cast<float>(lens[0]);
    camera.cx = static_cast<float>(lens[2]);
    camera.fy = static_cast<float>(lens[4]);
    camera.cy = static_cast<float>(lens[5]);
    camera.world_from_camera = inverse(rigid_of(poses.data_ptr<double>() + 16 * i, "camera_from_world"));
  }
  return cameras;
}

ObjectTransform object_of(const double* row_major) {
  const double scale = std::cbrt(glm::determinant(linear_of(row_major)));
  TORCH_CHECK(scale > 0, "rasterize: a matrix of world_from_object is not a rotation, a scale and a translation");
  ObjectTransform object = rigid_of(row_major, "world_from_object", scale);
  object.scale = static_cast<float>(scale);
  return object;
}

SceneState scene_of(const OptionalTensor& ambient_sh, at::ArrayRef<double> sun_direction,
                    at::ArrayRef<double> sun_irradiance, at::ArrayRef<double> background, at::IntArrayRef objects,
                    const OptionalTensor& world_from_object) {
  SceneState scene;
  scene.light.sun_direction = vector_of(sun_direction, "sun_direction");
  scene.light.sun_irradiance = vector_of(sun_irradiance, "sun_irradiance");
  scene.light.background = vector_of(background, "background");
  if (ambient_sh) {
    check_tensor(*ambient_sh, "rasterize", "ambient_sh", at::kFloat, {9, 3}, at::kCPU);
    const float* const values = ambient_sh->data_ptr<float>();
    for (std::size_t k = 0; k < 9; ++k) {
      scene.light.ambient_sh[k] = {values[3 * k], values[3 * k + 1], values[3 * k + 2]};
    }
  }
  const Tensor poses = world_from_object ? matrices_of(*world_from_object, 4, "world_from_object") : Tensor();
  const std::size_t count = poses.defined() ? static_cast<std::size_t>(poses.size(0)) : 0;
  TORCH_CHECK(objects.size() == count,
              words("rasterize: ", objects.size(), " objects and ", count, " matrices world_from_object"));
  for (std::size_t i = 0; i < count; ++i) {
    scene.objects[static_cast<std::uint32_t>(objects[i])] = object_of(poses.data_ptr<double>() + 16 * i);
  }
  return scene;
}

/// Calls an operation. What it throws leaves the library as a c10::Error that was made here: PyTorch then says
/// RuntimeError, and the message is ours alone, without the frames that an error carries from where it was thrown.
/// Being out of memory keeps its type, which programs catch.
template <class Operation>
auto run(const Operation& operation) -> decltype(operation()) {
  std::string message;
  try {
    return operation();
  } catch (const c10::OutOfMemoryError&) {
    throw;
  } catch (const c10::Error& error) {
    message = error.what_without_backtrace();
  } catch (const std::exception& error) {
    message = error.what();
  }
  throw c10::Error(std::move(message), {}, nullptr);
}

std::tuple<Tensor, Tensor, OptionalTensor, OptionalTensor> rasterize_operation(
    const Tensor& parameters, const Tensor& camera_from_world, const Tensor& intrinsics, std::int64_t width,
    std::int64_t height, const OptionalTensor& normal, const OptionalTensor& visibility,
    const OptionalTensor& object_id, const OptionalTensor& flags, const OptionalTensor& mean2d_norm,
    const OptionalTensor& contribution, const OptionalTensor& visible, const OptionalTensor& ambient_sh,
    at::ArrayRef<double> sun_direction, at::ArrayRef<double> sun_irradiance, at::ArrayRef<double> background,
    at::IntArrayRef objects, const OptionalTensor& world_from_object, bool antialias, double blur_px2, bool albedo,
    bool depth) {
  const GaussianPlanes planes{or_undefined(normal), or_undefined(visibility), or_undefined(object_id),
                              or_undefined(flags)};
  RenderOptions options;
  options.antialias = antialias;
  options.blur_px2 = static_cast<float>(blur_px2);
  options.albedo = albedo;
  options.depth = depth;
  const GaussianStatistics statistics{or_undefined(mean2d_norm), or_undefined(contribution), or_undefined(visible)};
  const RasterizedViews views = run([&] {
    // One by one, not in the list of arguments: each may throw, and then nothing is half made.
    const std::vector<Camera> cameras = cameras_of(camera_from_world, intrinsics, width, height);
    const std::vector<SceneState> scenes(
        1, scene_of(ambient_sh, sun_direction, sun_irradiance, background, objects, world_from_object));
    return rasterize(parameters, planes, cameras, scenes, options, statistics);
  });
  const auto optional = [](const Tensor& picture) {
    return picture.defined() ? OptionalTensor(picture) : OptionalTensor();
  };
  return {views.color, views.alpha, optional(views.albedo), optional(views.depth)};
}

Tensor image_loss_operation(const Tensor& rendered, const Tensor& targets, double ssim_weight, bool encode_srgb) {
  LossOptions options;
  options.ssim_weight = static_cast<float>(ssim_weight);
  options.encode_srgb = encode_srgb;
  return run([&] { return image_loss(rendered, targets, options); });
}

struct SparseAdamObject final : torch::CustomClassHolder, SparseAdam {
  using SparseAdam::SparseAdam;
};

TORCH_LIBRARY(splatbus, library) {
  library.def(
      "rasterize(Tensor parameters, Tensor camera_from_world, Tensor intrinsics, int width, int height, *, "
      "Tensor? normal=None, Tensor? visibility=None, Tensor? object_id=None, Tensor? flags=None, "
      "Tensor? mean2d_norm=None, Tensor? contribution=None, Tensor? visible=None, "
      "Tensor? ambient_sh=None, float[] sun_direction=[0.0, 1.0, 0.0], float[] sun_irradiance=[0.0, 0.0, 0.0], "
      "float[] background=[0.0, 0.0, 0.0], int[] objects=[], Tensor? world_from_object=None, "
      "bool antialias=True, float blur_px2=0.3, bool albedo=False, bool depth=False) "
      "-> (Tensor color, Tensor alpha, Tensor? albedo, Tensor? depth)",
      rasterize_operation);
  library.def("image_loss(Tensor rendered, Tensor targets, float ssim_weight=0.2, bool encode_srgb=True) -> Tensor",
              image_loss_operation);
  library.class_<SparseAdamObject>("SparseAdam")
      .def(torch::init([](Tensor parameters, const std::vector<double>& rates, double beta1, double beta2,
                          double epsilon, double lr_half_life, double lr_min_factor) {
             return run([&] {
               return c10::make_intrusive<SparseAdamObject>(
                   std::move(parameters), rates, SparseAdamOptions{beta1, beta2, epsilon, lr_half_life, lr_min_factor});
             });
           }),
           "",
           {torch::arg("parameters"), torch::arg("rates"), torch::arg("beta1") = 0.9, torch::arg("beta2") = 0.999,
            torch::arg("epsilon") = 1e-15, torch::arg("lr_half_life") = 0.0, torch::arg("lr_min_factor") = 0.0})
      .def("step", [](const c10::intrusive_ptr<SparseAdamObject>& adam) { run([&] { adam->step(); }); })
      .def("zero_grad", [](const c10::intrusive_ptr<SparseAdamObject>& adam) { run([&] { adam->zero_grad(); }); })
      .def("set_rates", [](const c10::intrusive_ptr<SparseAdamObject>& adam, const std::vector<double>& rates) {
        run([&] { adam->set_rates(rates); });
      });
}

}  // namespace
}  // namespace splatbus::raster
