#include "stream/quantised.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>

namespace splatbus::stream {

namespace {

float srgb_odd(float linear) {
  const float x = std::abs(linear);
  const float y = x <= 0.0031308F ? 12.92F * x : 1.055F * std::pow(x, 1 / 2.4F) - 0.055F;
  return std::copysign(y, linear);
}

float linear_odd(float encoded) {
  const float x = std::abs(encoded);
  const float y = x <= 0.04045F ? x / 12.92F : std::pow((x + 0.055F) / 1.055F, 2.4F);
  return std::copysign(y, encoded);
}

float sign_not_zero(float x) {
  return x < 0 ? -1.0F : 1.0F;
}

glm::vec2 octahedral(const glm::vec3& n) {
  const float sum = std::abs(n.x) + std::abs(n.y) + std::abs(n.z);
  if (sum < 1e-12F) return {0, 0};
  const glm::vec2 p(n.x / sum, n.y / sum);
  if (n.z >= 0) return p;
  return {(1 - std::abs(p.y)) * sign_not_zero(p.x), (1 - std::abs(p.x)) * sign_not_zero(p.y)};
}

glm::vec3 from_octahedral(const glm::vec2& e) {
  glm::vec3 n(e.x, e.y, 1 - std::abs(e.x) - std::abs(e.y));
  if (n.z < 0) {
    n = {(1 - std::abs(e.y)) * sign_not_zero(e.x), (1 - std::abs(e.x)) * sign_not_zero(e.y), n.z};
  }
  const float length = glm::length(n);
  return length > 0 ? n / length : glm::vec3(0, 0, 1);
}

glm::quat from_rotation_vector(const glm::vec3& v) {
  const float angle = glm::length(v);
  if (angle < 1e-6F) return {1, v.x / 2, v.y / 2, v.z / 2};
  const glm::vec3 axis = v * (std::sin(angle / 2) / angle);
  return {std::cos(angle / 2), axis.x, axis.y, axis.z};
}

// Angle in [0, 2 pi]: a quaternion with w < 0 is the long way round.
glm::vec3 to_rotation_vector(const glm::quat& q) {
  const glm::vec3 v(q.x, q.y, q.z);
  const float sine = glm::length(v);
  if (sine < 1e-7F) return 2.0F * v;
  return v * (2 * std::atan2(sine, q.w) / sine);
}

// R S S R^T is the same for q times half a turn about an axis of the Gaussian.
glm::quat nearest_equivalent(const glm::quat& q, const glm::quat& held) {
  const std::array<glm::quat, 4> candidates{q, q * glm::quat(0, 1, 0, 0), q * glm::quat(0, 0, 1, 0),
                                            q * glm::quat(0, 0, 0, 1)};
  glm::quat best = candidates[0];
  float best_dot = glm::dot(best, held);
  for (const glm::quat& candidate : candidates) {
    const float dot = glm::dot(candidate, held);
    if (std::abs(dot) > std::abs(best_dot)) {
      best = candidate;
      best_dot = dot;
    }
  }
  return best_dot < 0 ? -best : best;
}

// Quantises one value; the bounds also keep the conversion to an integer defined.
class Step {
 public:
  explicit Step(const AttributeChannels& a)
      : offset_(a.quantiser.offset),
        per_step_(1 / a.quantiser.step),
        minimum_(static_cast<float>(a.minimum)),
        maximum_(static_cast<float>(a.maximum)) {}
  [[nodiscard]] std::int32_t operator()(float value) const {
    const float q = (value - offset_) * per_step_;
    const float bounded = q >= minimum_ ? std::min(q, maximum_) : minimum_;    // NaN gives the minimum
    return static_cast<std::int32_t>(bounded + std::copysign(0.5F, bounded));  // half away from zero; vectorizes
  }

 private:
  float offset_, per_step_, minimum_, maximum_;
};

int parameter_channel(Attribute attribute) {
  switch (attribute) {
    case Attribute::Mean:
      return ParameterLayout::kMean;
    case Attribute::LogScale:
      return ParameterLayout::kLogScale;
    case Attribute::Rotation:
      return ParameterLayout::kRotation;
    case Attribute::Opacity:
      return ParameterLayout::kOpacityLogit;
    case Attribute::Residual:
      return ParameterLayout::kResidual;
    case Attribute::ShRest:
      return ParameterLayout::kAppearance + 3;
    default:
      return ParameterLayout::kAppearance;
  }
}

void mark_unusable(const float* plane, std::size_t count, std::vector<std::uint8_t>& usable) {
  for (std::size_t i = 0; i < count; ++i) usable[i] &= static_cast<std::uint8_t>(std::isfinite(plane[i]));
}

void quantise_rotation(const GaussiansView& in, const StreamLayout& layout, QuantisedGaussians& out,
                       const QuantisedGaussians* held, const std::uint32_t* held_column) {
  const AttributeChannels& a = layout.at(Attribute::Rotation);
  const Step step(a);
  const float* w = in.plane(ParameterLayout::kRotation);
  const float* x = in.plane(ParameterLayout::kRotation + 1);
  const float* y = in.plane(ParameterLayout::kRotation + 2);
  const float* z = in.plane(ParameterLayout::kRotation + 3);
  for (std::size_t i = 0; i < in.count; ++i) {
    glm::quat q(w[i], x[i], y[i], z[i]);
    const float length = glm::length(q);
    q = length > 1e-12F && std::isfinite(length) ? q / length : glm::quat(1, 0, 0, 0);
    glm::quat reference(1, 0, 0, 0);
    if (held && held_column && held_column[i] != kNotHeld) {
      const std::uint32_t column = held_column[i];
      reference = from_rotation_vector(glm::vec3(held->planes[a.first][column], held->planes[a.first + 1][column],
                                                 held->planes[a.first + 2][column]) *
                                       a.quantiser.step);
    }
    const glm::vec3 v = to_rotation_vector(nearest_equivalent(q, reference));
    for (int c = 0; c < 3; ++c) out.planes[a.first + c][i] = step(v[c]);
  }
}

void quantise_normal(const GaussiansView& in, const AttributeChannels& a, QuantisedGaussians& out) {
  const Step step(a);
  for (std::size_t i = 0; i < in.count; ++i) {
    const glm::vec3 n = in.normal ? glm::vec3(in.normal[i], in.normal[in.stride + i], in.normal[2 * in.stride + i])
                                  : glm::vec3(0, 1, 0);
    const glm::vec2 e = octahedral(n);
    out.planes[a.first][i] = step(e.x);
    out.planes[a.first + 1][i] = step(e.y);
  }
}

void find_unusable(const GaussiansView& in, std::vector<std::uint8_t>& usable) {
  usable.assign(in.count, 1);
  for (int c = 0; c < in.layout.channels(); ++c) mark_unusable(in.plane(c), in.count, usable);
  if (in.layout.appearance != Appearance::Transfer) return;
  for (int c = 0; in.normal && c < 3; ++c) mark_unusable(in.normal + c * in.stride, in.count, usable);
  if (in.visibility) mark_unusable(in.visibility, in.count, usable);
}

template <class Map>
void quantise_planes(const GaussiansView& in, const AttributeChannels& a, QuantisedGaussians& out, Map map) {
  const Step step(a);
  for (int c = 0; c < a.channels; ++c) {
    const float* from = in.plane(parameter_channel(a.attribute) + c);
    std::int32_t* to = out.planes[a.first + c].data();
    for (std::size_t i = 0; i < in.count; ++i) to[i] = step(map(from[i]));
  }
}

}  // namespace

QuantisedGaussians::QuantisedGaussians(const StreamLayout& layout, std::size_t count) : planes(layout.channels()) {
  resize(count);
}

void QuantisedGaussians::resize(std::size_t count) {
  for (auto& plane : planes) plane.resize(count);
  object_id.resize(count);
  gaussian_id.resize(count);
}

void QuantisedGaussians::append(const QuantisedGaussians& other) {
  assert(planes.size() == other.planes.size());
  for (std::size_t c = 0; c < planes.size(); ++c) {
    planes[c].insert(planes[c].end(), other.planes[c].begin(), other.planes[c].end());
  }
  object_id.insert(object_id.end(), other.object_id.begin(), other.object_id.end());
  gaussian_id.insert(gaussian_id.end(), other.gaussian_id.begin(), other.gaussian_id.end());
}

QuantisedGaussians QuantisedGaussians::gather(std::span<const std::uint32_t> columns) const {
  QuantisedGaussians out;
  out.planes.resize(planes.size());
  out.resize(columns.size());
  for (std::size_t c = 0; c < planes.size(); ++c) {
    for (std::size_t i = 0; i < columns.size(); ++i) out.planes[c][i] = planes[c][columns[i]];
  }
  for (std::size_t i = 0; i < columns.size(); ++i) {
    out.object_id[i] = object_id[columns[i]];
    out.gaussian_id[i] = gaussian_id[columns[i]];
  }
  return out;
}

void QuantisedGaussians::remove(std::span<const std::uint32_t> ascending) {
  for (auto& plane : planes) remove_at(plane, ascending);
  remove_at(object_id, ascending);
  remove_at(gaussian_id, ascending);
}

void quantise(const GaussiansView& gaussians, const StreamLayout& layout, QuantisedGaussians& out,
              std::vector<std::uint8_t>& usable, const QuantisedGaussians* held, const std::uint32_t* held_column) {
  assert(layout.carries(gaussians.layout));
  const std::size_t count = gaussians.count;
  out.planes.resize(static_cast<std::size_t>(layout.channels()));
  out.resize(count);
  find_unusable(gaussians, usable);
  for (const AttributeChannels& a : layout.attributes()) {
    switch (a.attribute) {
      case Attribute::Rotation:
        quantise_rotation(gaussians, layout, out, held, held_column);
        break;
      case Attribute::Normal:
        quantise_normal(gaussians, a, out);
        break;
      case Attribute::Opacity:
        quantise_planes(gaussians, a, out, [](float logit) { return 1 / (1 + std::exp(-logit)); });
        break;
      case Attribute::Albedo:
        quantise_planes(gaussians, a, out, srgb_odd);
        break;
      case Attribute::Visibility: {
        const Step step(a);
        for (std::size_t i = 0; i < count; ++i) {
          out.planes[a.first][i] = step(gaussians.visibility ? gaussians.visibility[i] : 1.0F);
        }
        break;
      }
      default:
        quantise_planes(gaussians, a, out, [](float value) { return value; });
    }
  }
  for (std::size_t i = 0; i < count; ++i) {
    out.object_id[i] = gaussians.object_id ? gaussians.object_id[i] : 0;
    out.gaussian_id[i] = gaussians.gaussian_id ? gaussians.gaussian_id[i] : 0;
    if (usable[i]) continue;
    for (auto& plane : out.planes) plane[i] = 0;
  }
}

void dequantise(const QuantisedGaussians& gaussians, const StreamLayout& layout, Attribute attribute,
                std::span<const std::uint32_t> columns, const DequantisedPlanes& out) {
  const AttributeChannels& a = layout.at(attribute);
  const auto value = [&](int channel, std::uint32_t column) {
    return a.quantiser.offset + a.quantiser.step * static_cast<float>(gaussians.planes[a.first + channel][column]);
  };
  const auto plane = [&](int channel) { return out.parameters + static_cast<std::size_t>(channel) * out.stride; };
  const int first = parameter_channel(attribute);
  switch (attribute) {
    case Attribute::Rotation:
      for (const std::uint32_t i : columns) {
        const glm::quat q = from_rotation_vector({value(0, i), value(1, i), value(2, i)});
        plane(first)[i] = q.w;
        plane(first + 1)[i] = q.x;
        plane(first + 2)[i] = q.y;
        plane(first + 3)[i] = q.z;
      }
      return;
    case Attribute::Opacity:
      for (const std::uint32_t i : columns) {
        const float opacity = std::clamp(value(0, i), 0.0005F, 0.9995F);
        plane(first)[i] = std::log(opacity / (1 - opacity));
      }
      return;
    case Attribute::Normal:
      for (const std::uint32_t i : columns) {
        const glm::vec3 n = from_octahedral({value(0, i), value(1, i)});
        for (int c = 0; c < 3; ++c) out.normal[c * out.stride + i] = n[c];
      }
      return;
    case Attribute::Visibility:
      for (const std::uint32_t i : columns) out.visibility[i] = value(0, i);
      return;
    default:
      break;
  }
  const bool albedo = attribute == Attribute::Albedo;
  for (int c = 0; c < a.channels; ++c) {
    float* to = plane(first + c);
    for (const std::uint32_t i : columns) to[i] = albedo ? linear_odd(value(c, i)) : value(c, i);
  }
}

}  // namespace splatbus::stream
