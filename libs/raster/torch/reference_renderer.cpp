#include "raster/torch/reference_renderer.h"

#include <torch/nn/functional/conv.h>

#include <algorithm>
#include <cmath>
#include <glm/glm.hpp>
#include <numbers>
#include <vector>

namespace splatbus::raster {
namespace {

using torch::Tensor;

constexpr double kConstantSh = 0.28209479177387814;

/// Values that every Gaussian takes from its object: [count, ...] tensors gathered from small tables.
struct ObjectTensors {
  Tensor camera_from_object;            // [N, 3, 3], rotation times scale
  Tensor translation, camera_position;  // [N, 3]
  Tensor ambient;                       // [N, 9, 3]
  Tensor shown;                         // [N] bool: the scene has the object
};

/// What arrives of one light at every Gaussian, in its object's frame.
struct ArrivingLight {
  Tensor direction;   // [N, 3], towards the light
  Tensor irradiance;  // [N, 3], on a surface that faces it, of what is visible
};

Tensor tensor_of(const std::vector<double>& values, at::IntArrayRef shape, const torch::TensorOptions& type) {
  return torch::tensor(values, torch::kFloat64).reshape(shape).to(type);
}

/// Of Gaussian i; null when the scene does not have it.
const ObjectTransform* object_of(const GaussiansView& gaussians, const SceneState& scene, std::size_t i) {
  static const ObjectTransform world;
  const std::uint32_t frame_id = gaussians.object_id != nullptr ? gaussians.object_id[i] : kWorldFrame;
  if (frame_id == kWorldFrame) return &world;
  const auto found = scene.objects.find(frame_id);
  return found != scene.objects.end() ? &found->second : nullptr;
}

ObjectTensors gather_objects(const GaussiansView& gaussians, const Camera& camera, const SceneState& scene,
                             const torch::TensorOptions& type) {
  const Rigid camera_from_world = inverse(camera.world_from_camera);
  std::vector<double> linear, translation, position, ambient, shown;
  for (std::size_t i = 0; i < gaussians.count; ++i) {
    const ObjectTransform* const found = object_of(gaussians, scene, i);
    const ObjectTransform object = found != nullptr ? *found : ObjectTransform();
    shown.push_back(found != nullptr ? 1 : 0);
    const Rigid camera_from_object = camera_from_world * object.rigid;
    const glm::mat3 r = glm::mat3_cast(glm::normalize(camera_from_object.rotation));
    const glm::vec3 eye = inverse(camera_from_object).translation;
    for (int row = 0; row < 3; ++row) {
      for (int column = 0; column < 3; ++column) linear.push_back(double{object.scale} * r[column][row]);
      translation.push_back(camera_from_object.translation[row]);
      position.push_back(double{eye[row]} / object.scale);
    }
    const auto rotated = rotate_sh9(scene.light.ambient_sh, glm::conjugate(object.rigid.rotation));
    for (std::size_t k = 0; k < 9; ++k) {
      // What is emissive sees the same of all sides, so much that it shows its albedo.
      const double white = k == 0 ? 1 / kConstantSh : 0;
      for (int c = 0; c < 3; ++c) ambient.push_back(object.emissive ? white : double{rotated[k][c]});
    }
  }
  const auto n = static_cast<std::int64_t>(gaussians.count);
  return {tensor_of(linear, {n, 3, 3}, type), tensor_of(translation, {n, 3}, type), tensor_of(position, {n, 3}, type),
          tensor_of(ambient, {n, 9, 3}, type), tensor_of(shown, {n}, type) > 0};
}

struct WorldIncident {
  glm::dvec3 to_light, irradiance;
};

/// schemas/common.fbs has the formulas.
WorldIncident arriving(const LightSource& source, const glm::dvec3& point, double min_distance) {
  const glm::dvec3 intensity(source.intensity), direction(source.direction);
  if (source.kind == LightKind::Directional) return {direction, intensity};
  const glm::dvec3 way = glm::dvec3(source.position) - point;
  const double distance = std::max(glm::length(way), min_distance);
  const double window = std::max(0.0, 1 - std::pow(distance / source.range_m, 4));
  double factor = std::pow(window / distance, 2);
  if (source.kind == LightKind::Spot) {
    const double cosine = glm::dot(-way / distance, direction), outer = source.cos_outer;
    factor *= std::pow(std::clamp((cosine - outer) / (source.cos_inner - outer), 0.0, 1.0), 2);
  }
  return {way / distance, factor * intensity};
}

/// The sun, then the sources, worked out in the world; light 0 is the sun. Means are values: no gradient leads to them.
std::vector<ArrivingLight> arriving_lights(const Tensor& parameters, const GaussiansView& gaussians,
                                           const SceneState& scene, const torch::TensorOptions& type) {
  const auto n = static_cast<std::int64_t>(gaussians.count);
  const Tensor means = parameters.detach().slice(0, 0, 3).to(torch::kFloat64).contiguous();
  const double* const mean = means.data_ptr<double>();
  const auto visibility_of = [&](std::size_t light, std::size_t i) -> double {
    if (gaussians.visibility_u8 != nullptr && light < gaussians.visibility_rows) {
      return gaussians.visibility_u8[light * gaussians.visibility_stride + i] / 255.0;
    }
    return light == 0 && gaussians.visibility != nullptr ? gaussians.visibility[i] : 1;
  };
  std::vector<ArrivingLight> lights;
  for (std::size_t light = 0; light <= scene.light.sources.size(); ++light) {
    std::vector<double> directions, irradiances;
    for (std::size_t i = 0; i < gaussians.count; ++i) {
      const ObjectTransform* const found = object_of(gaussians, scene, i);
      const ObjectTransform object = found != nullptr ? *found : ObjectTransform();
      const glm::dquat rotation(object.rigid.rotation);
      const glm::dvec3 of_object(mean[i], mean[gaussians.count + i], mean[2 * gaussians.count + i]);
      const glm::dvec3 point = rotation * (double{object.scale} * of_object) + glm::dvec3(object.rigid.translation);
      WorldIncident incident{glm::dvec3(scene.light.sun_direction), glm::dvec3(scene.light.sun_irradiance)};
      if (light > 0) incident = arriving(scene.light.sources[light - 1], point, 0.01 * object.scale);
      const glm::dvec3 direction = glm::conjugate(rotation) * incident.to_light;
      const double share = object.emissive ? 0 : visibility_of(light, i);
      for (int c = 0; c < 3; ++c) {
        directions.push_back(direction[c]);
        irradiances.push_back(share * incident.irradiance[c]);
      }
    }
    lights.push_back({tensor_of(directions, {n, 3}, type), tensor_of(irradiances, {n, 3}, type)});
  }
  return lights;
}

/// The 3DGS basis (Kerbl et al. 2023, eval_sh) of unit directions [N, 3], as [N, (degree + 1)^2].
Tensor sh_basis(const Tensor& direction, int degree) {
  const Tensor x = direction.select(1, 0), y = direction.select(1, 1), z = direction.select(1, 2);
  std::vector<Tensor> b{torch::full_like(x, kConstantSh)};
  if (degree > 0) {
    constexpr double kC1 = 0.4886025119029199;
    b.insert(b.end(), {-kC1 * y, kC1 * z, -kC1 * x});
  }
  if (degree > 1) {
    b.insert(b.end(), {1.0925484305920792 * x * y, -1.0925484305920792 * y * z,
                       0.31539156525252005 * (2 * z * z - x * x - y * y), -1.0925484305920792 * x * z,
                       0.5462742152960396 * (x * x - y * y)});
  }
  if (degree > 2) {
    b.insert(b.end(), {-0.5900435899266435 * y * (3 * x * x - y * y), 2.890611442640554 * x * y * z,
                       -0.4570457994644658 * y * (4 * z * z - x * x - y * y),
                       0.3731763325901154 * z * (2 * z * z - 3 * x * x - 3 * y * y),
                       -0.4570457994644658 * x * (4 * z * z - x * x - y * y), 1.445305721320277 * z * (x * x - y * y),
                       -0.5900435899266435 * x * (x * x - 3 * y * y)});
  }
  return torch::stack(b, 1);
}

Tensor rotation_matrices(const Tensor& quaternions) {  // [N, 4] wxyz -> [N, 3, 3]
  const Tensor q = quaternions / quaternions.norm(2, 1, true);
  const Tensor w = q.select(1, 0), x = q.select(1, 1), y = q.select(1, 2), z = q.select(1, 3);
  return torch::stack({1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),  //
                       2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),  //
                       2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)},
                      1)
      .reshape({-1, 3, 3});
}

Tensor plane_tensor(const float* plane, std::size_t channels, const GaussiansView& gaussians, double absent,
                    const torch::TensorOptions& type) {
  const auto n = static_cast<std::int64_t>(gaussians.count), c = static_cast<std::int64_t>(channels);
  if (plane == nullptr) return torch::full({n, c}, absent, type);
  std::vector<double> values;
  for (std::size_t i = 0; i < gaussians.count; ++i) {
    for (std::size_t k = 0; k < channels; ++k) values.push_back(plane[k * gaussians.stride + i]);
  }
  return tensor_of(values, {n, c}, type);
}

Tensor colours(const Tensor& p, const Tensor& mean, const GaussiansView& gaussians, const ObjectTensors& objects,
               const SceneState& scene, const torch::TensorOptions& type) {
  const ParameterLayout& layout = gaussians.layout;
  if (layout.appearance == Appearance::Radiance) {
    const Tensor offset = mean - objects.camera_position;
    const Tensor basis = sh_basis(offset / offset.norm(2, 1, true), layout.sh_degree);
    const Tensor coefficients = p.slice(0, ParameterLayout::kAppearance).t().reshape({p.size(1), -1, 3});
    return torch::clamp_min(0.5 + (basis.unsqueeze(2) * coefficients).sum(1), 0);
  }
  const Tensor normal = plane_tensor(gaussians.normal, 3, gaussians, 0, type);
  const Tensor factors = tensor_of({1, 2.0 / 3, 2.0 / 3, 2.0 / 3, 0.25, 0.25, 0.25, 0.25, 0.25}, {1, 9}, type);
  Tensor reflected = ((sh_basis(normal, 2) * factors).unsqueeze(2) * objects.ambient).sum(1);  // [N, 3]
  Tensor incident = objects.ambient;                                                           // [N, 9, 3]
  for (const ArrivingLight& light : arriving_lights(p, gaussians, scene, type)) {
    const Tensor over_pi = light.irradiance * std::numbers::inv_pi;
    reflected = reflected + torch::clamp_min((normal * light.direction).sum(1, true), 0) * over_pi;
    incident = incident + sh_basis(light.direction, 2).unsqueeze(2) * over_pi.unsqueeze(1);
  }
  const Tensor albedo = p.slice(0, ParameterLayout::kAlbedo, ParameterLayout::kResidual).t();
  const Tensor residual = p.slice(0, ParameterLayout::kResidual).t().reshape({p.size(1), 9, 3});
  return torch::clamp_min(albedo * reflected + (residual * incident).sum(1), 0);
}

}  // namespace

ReferenceRender reference_render(const Tensor& parameters, const GaussiansView& gaussians, const Camera& camera,
                                 const SceneState& scene, const RenderOptions& options) {
  const torch::TensorOptions type = parameters.options().requires_grad(false);
  const auto width = static_cast<std::int64_t>(camera.width), height = static_cast<std::int64_t>(camera.height);
  const ObjectTensors objects = gather_objects(gaussians, camera, scene, type);

  // What cannot be seen is left out first: its projection may not be finite.
  const Tensor mean_all = parameters.slice(0, 0, 3).t();
  const Tensor camera_all =
      torch::matmul(objects.camera_from_object, mean_all.unsqueeze(2)).squeeze(2) + objects.translation;
  const Tensor seen = ((camera_all.select(1, 2) > camera.near_m) & objects.shown).nonzero().squeeze(1);
  const Tensor colour_all = colours(parameters, mean_all, gaussians, objects, scene, type);

  const Tensor p = parameters.index_select(1, seen), point = camera_all.index_select(0, seen);
  const Tensor x = point.select(1, 0), y = point.select(1, 1), z = point.select(1, 2);
  const double half_x = 0.5 * camera.width / camera.fx, half_y = 0.5 * camera.height / camera.fy;
  const Tensor tan_x =
      torch::clamp(x / z, -camera.cx / camera.fx - 0.3 * half_x, (camera.width - camera.cx) / camera.fx + 0.3 * half_x);
  const Tensor tan_y = torch::clamp(y / z, -camera.cy / camera.fy - 0.3 * half_y,
                                    (camera.height - camera.cy) / camera.fy + 0.3 * half_y);
  const Tensor zero = torch::zeros_like(z);
  const Tensor jacobian = torch::stack({camera.fx / z, zero, -camera.fx * tan_x / z,  //
                                        zero, camera.fy / z, -camera.fy * tan_y / z},
                                       1)
                              .reshape({-1, 2, 3});
  const Tensor scaled = rotation_matrices(p.slice(0, 6, 10).t()) * torch::exp(p.slice(0, 3, 6).t()).unsqueeze(1);
  const Tensor m = torch::matmul(torch::matmul(jacobian, objects.camera_from_object.index_select(0, seen)), scaled);
  const Tensor covariance = torch::matmul(m, m.transpose(1, 2));
  const Tensor a_sharp = covariance.select(1, 0).select(1, 0), c_sharp = covariance.select(1, 1).select(1, 1);
  const Tensor b = covariance.select(1, 0).select(1, 1);
  const Tensor a = a_sharp + options.blur_px2, c = c_sharp + options.blur_px2;
  const Tensor determinant = a * c - b * b;
  Tensor opacity = torch::sigmoid(p.select(0, ParameterLayout::kOpacityLogit));
  if (options.antialias) {
    opacity = opacity * torch::sqrt(torch::clamp_min((a_sharp * c_sharp - b * b) / determinant, 1e-30));
  }

  const auto order = std::get<1>(torch::sort(z.detach(), /*stable=*/true, /*dim=*/0, /*descending=*/false));
  const auto sorted = [&](const Tensor& values) { return values.index_select(0, order).unsqueeze(1); };
  const Tensor pixel_x = (torch::arange(width, type) + 0.5).unsqueeze(0).expand({height, width}).reshape({1, -1});
  const Tensor pixel_y = (torch::arange(height, type) + 0.5).unsqueeze(1).expand({height, width}).reshape({1, -1});
  const Tensor dx = pixel_x - sorted(camera.fx * x / z + camera.cx);
  const Tensor dy = pixel_y - sorted(camera.fy * y / z + camera.cy);
  const Tensor power = -0.5 * (sorted(c / determinant) * dx * dx - 2 * sorted(b / determinant) * dx * dy +
                               sorted(a / determinant) * dy * dy);
  Tensor alpha = sorted(opacity) * torch::exp(power);
  alpha = torch::where(alpha >= 1.0 / 255, torch::clamp_max(alpha, 0.999), torch::zeros_like(alpha));
  const Tensor one = torch::ones({1, width * height}, type);
  const auto transmittance_before = [&](const Tensor& alphas) {
    return torch::cat({one, torch::cumprod(1 - alphas, 0)}, 0).slice(0, 0, alphas.size(0) + 1);
  };
  const Tensor ended = transmittance_before(alpha.detach()).slice(0, 0, alpha.size(0)) < 1e-4;
  alpha = torch::where(ended, torch::zeros_like(alpha), alpha);
  const Tensor transmittance = transmittance_before(alpha);
  const Tensor weight = (alpha * transmittance.slice(0, 0, alpha.size(0))).t();  // [pixels, N]
  const Tensor through = transmittance.select(0, alpha.size(0));                 // [pixels]

  const auto blend = [&](const Tensor& values) {  // [N, C] -> [C, H, W]
    return torch::matmul(weight, values.index_select(0, order)).t().reshape({values.size(1), height, width});
  };
  std::vector<double> background(3);
  for (int k = 0; k < 3; ++k) {
    const float linear = scene.light.background[k];
    background[static_cast<std::size_t>(k)] =
        gaussians.layout.appearance == Appearance::Radiance ? srgb_from_linear(linear) : linear;
  }
  ReferenceRender out;
  out.color = blend(colour_all.index_select(0, seen)) +
              tensor_of(background, {3, 1, 1}, type) * through.reshape({1, height, width});
  out.alpha = (1 - through).reshape({height, width});
  if (options.albedo && gaussians.layout.appearance == Appearance::Transfer) {
    out.albedo = blend(p.slice(0, ParameterLayout::kAlbedo, ParameterLayout::kResidual).t());
  }
  if (options.depth) out.depth = blend(z.unsqueeze(1)).squeeze(0);
  return out;
}

Tensor reference_loss(const Tensor& rendered, const Tensor& target, float ssim_weight, bool encode_srgb) {
  const torch::TensorOptions type = rendered.options().requires_grad(false);
  Tensor shown = torch::clamp(rendered, 0, 1);
  if (encode_srgb) {
    shown = torch::where(shown <= 0.0031308, 12.92 * shown,
                         1.055 * torch::pow(torch::clamp_min(shown, 0.0031308), 1 / 2.4) - 0.055);
  }
  const Tensor taps = torch::exp(-torch::pow(torch::arange(11, type) - 5, 2) / (2 * 1.5 * 1.5));
  const Tensor window = torch::outer(taps, taps) / (taps.sum() * taps.sum());
  const Tensor kernel = window.reshape({1, 1, 11, 11}).expand({3, 1, 11, 11});
  const auto blur = [&](const Tensor& image) {
    return torch::nn::functional::conv2d(image.unsqueeze(0), kernel,
                                         torch::nn::functional::Conv2dFuncOptions().padding(5).groups(3));
  };
  const Tensor mean_x = blur(shown), mean_y = blur(target);
  const Tensor variance_x = blur(shown * shown) - mean_x * mean_x, variance_y = blur(target * target) - mean_y * mean_y;
  const Tensor covariance = blur(shown * target) - mean_x * mean_y;
  const double c1 = 0.01 * 0.01, c2 = 0.03 * 0.03;
  const Tensor ssim = (2 * mean_x * mean_y + c1) * (2 * covariance + c2) /
                      ((mean_x * mean_x + mean_y * mean_y + c1) * (variance_x + variance_y + c2));
  return (1 - ssim_weight) * (shown - target).abs().mean() + ssim_weight * (1 - ssim.mean());
}

}  // namespace splatbus::raster
