#include "raster/torch/rasterize.h"

#include <torch/csrc/autograd/custom_function.h>

#include <cmath>
#include <utility>

#include "raster/torch/backend.h"
#include "raster/torch/checks.h"

namespace splatbus::raster {
namespace {

using torch::Tensor;
using torch::autograd::AutogradContext;
using torch::autograd::variable_list;

constexpr std::int64_t kMaxGaussians = (std::int64_t{1} << 24) - 1;  // what both backends take
constexpr std::uint32_t kMaxSide = 1U << 15U;
constexpr std::size_t kMaxPixels = std::size_t{1} << 30;

ParameterLayout layout_of(std::int64_t channels) {
  ParameterLayout layout;
  if (channels == layout.channels()) return layout;
  layout.appearance = Appearance::Radiance;
  for (layout.sh_degree = 0; layout.sh_degree <= 3; ++layout.sh_degree) {
    if (channels == layout.channels()) return layout;
  }
  TORCH_CHECK(false, words("rasterize: parameters has ", channels,
                           " channels; a Transfer model has 41, a Radiance model 14, 23, 38 or 59"));
  return layout;
}

void check_planes(const Tensor& parameters, const GaussianPlanes& planes) {
  const std::int64_t count = parameters.size(1);
  const at::Device device = parameters.device();
  const auto check = [&](const Tensor& plane, const char* name, at::ScalarType type, at::IntArrayRef shape) {
    if (!plane.defined()) return;
    check_tensor(plane, "rasterize", name, type, shape, device);
    TORCH_CHECK(!plane.requires_grad(),
                words("rasterize: ", name, " requires a gradient, and only parameters have one"));
  };
  check(planes.normal, "normal", at::kFloat, {3, count});
  check(planes.visibility, "visibility", at::kFloat, {count});
  check(planes.object_id, "object_id", at::kInt, {count});
  check(planes.flags, "flags", at::kInt, {count});
}

void check_statistics(const Tensor& parameters, const GaussianStatistics& statistics) {
  const auto check = [&](const Tensor& values, const char* name, at::ScalarType type) {
    if (values.defined()) check_tensor(values, "rasterize", name, type, {parameters.size(1)}, parameters.device());
  };
  check(statistics.mean2d_norm, "mean2d_norm", at::kFloat);
  check(statistics.contribution, "contribution", at::kFloat);
  check(statistics.touched, "touched", at::kByte);
}

void check_cameras(const std::vector<Camera>& cameras, const std::vector<SceneState>& scenes) {
  TORCH_CHECK(!cameras.empty() && cameras.size() <= kMaxCameras,
              words("rasterize: ", cameras.size(), " cameras; a call takes 1 to ", kMaxCameras));
  TORCH_CHECK(
      scenes.size() == 1 || scenes.size() == cameras.size(),
      words("rasterize: ", scenes.size(), " scenes for ", cameras.size(), " cameras; one is needed, or one a camera"));
  for (std::size_t k = 0; k < cameras.size(); ++k) {
    const Camera& camera = cameras[k];
    TORCH_CHECK(camera.role != CameraRole::Light,
                words("rasterize: camera ", k, " is a light's, which is orthographic"));
    TORCH_CHECK(camera.width > 0 && camera.height > 0 && camera.width <= kMaxSide && camera.height <= kMaxSide,
                words("rasterize: camera ", k, " has ", camera.width, " x ", camera.height, " pixels; a side has 1 to ",
                      kMaxSide));
    TORCH_CHECK(camera.width == cameras[0].width && camera.height == cameras[0].height,
                words("rasterize: camera ", k, " has ", camera.width, " x ", camera.height, " pixels, camera 0 ",
                      cameras[0].width, " x ", cameras[0].height, "; the cameras of a call have one size"));
    TORCH_CHECK(std::isfinite(camera.fx) && std::isfinite(camera.fy) && camera.fx > 0 && camera.fy > 0,
                words("rasterize: camera ", k, " has focal lengths of ", camera.fx, " and ", camera.fy, " pixels"));
  }
  const std::size_t pixels = std::size_t{cameras[0].width} * cameras[0].height;
  TORCH_CHECK(pixels <= kMaxPixels / cameras.size(),
              words("rasterize: ", cameras.size(), " pictures of ", cameras[0].width, " x ", cameras[0].height,
                    " pixels are more than 2^30 pixels"));
}

class RasterizeFunction : public torch::autograd::Function<RasterizeFunction> {
 public:
  /// Color, alpha, and of albedo and depth what there is.
  static variable_list forward(AutogradContext* context, const Tensor& parameters,
                               const c10::intrusive_ptr<RasterPass>& pass) {
    std::vector<Tensor> kept;
    const RasterizedViews views = pass->forward(parameters, true, kept);
    const GaussianPlanes& planes = pass->call.planes;
    variable_list saved{parameters, planes.normal, planes.visibility, planes.object_id, planes.flags};
    saved.insert(saved.end(), kept.begin(), kept.end());
    context->save_for_backward(std::move(saved));
    context->set_materialize_grads(false);
    context->saved_data["pass"] = at::IValue::make_capsule(pass);
    variable_list out{views.color, views.alpha};
    if (views.albedo.defined()) out.push_back(views.albedo);
    if (views.depth.defined()) out.push_back(views.depth);
    return out;
  }

  static variable_list backward(AutogradContext* context, variable_list gradients) {
    TORCH_CHECK(!at::GradMode::is_enabled(), "rasterize: there is no second derivative, which create_graph asks for");
    const variable_list saved = context->get_saved_variables();
    const auto holder = context->saved_data["pass"].toCapsule();
    auto& pass = static_cast<RasterPass&>(*holder);
    for (Tensor& gradient : gradients) {
      if (gradient.defined()) gradient = gradient.contiguous();
    }
    RasterizedViews views{gradients[0], gradients[1], {}, {}};
    std::size_t next = 2;
    if (has_albedo(pass.call)) views.albedo = gradients[next++];
    if (pass.call.options.depth) views.depth = gradients[next++];
    constexpr std::ptrdiff_t kInputs = 5;
    return {pass.backward(saved[0], {saved.begin() + kInputs, saved.end()}, views), Tensor()};
  }
};

}  // namespace

RasterizedViews rasterize(const Tensor& parameters, const GaussianPlanes& planes, const std::vector<Camera>& cameras,
                          const std::vector<SceneState>& scenes, const RenderOptions& options,
                          const GaussianStatistics& statistics) {
  TORCH_CHECK(parameters.defined() && parameters.dim() == 2, "rasterize: parameters is not [channels, count]");
  const std::int64_t count = parameters.size(1);
  TORCH_CHECK(count <= kMaxGaussians, words("rasterize: ", count, " Gaussians; at most ", kMaxGaussians, " are drawn"));
  const ParameterLayout layout = layout_of(parameters.size(0));
  check_tensor(parameters, "rasterize", "parameters", at::kFloat, parameters.sizes(), parameters.device());
  check_planes(parameters, planes);
  check_statistics(parameters, statistics);
  check_cameras(cameras, scenes);
  RasterCall call{layout, planes, cameras, scenes, options, statistics};

  const bool albedo = has_albedo(call), depth = options.depth;
  const c10::intrusive_ptr<RasterPass> pass = make_pass(std::move(call), parameters.device());
  if (!at::GradMode::is_enabled() || !parameters.requires_grad()) {
    std::vector<Tensor> kept;
    return pass->forward(parameters, false, kept);
  }
  const variable_list out = RasterizeFunction::apply(parameters, pass);
  RasterizedViews views{out[0], out[1], {}, {}};
  std::size_t next = 2;
  if (albedo) views.albedo = out[next++];
  if (depth) views.depth = out[next++];
  return views;
}

}  // namespace splatbus::raster
