#include "stream/layout.h"

#include <fmt/format.h>

#include <algorithm>
#include <cassert>
#include <cmath>

#include "stream/bytes.h"

namespace splatbus::stream {

namespace {

constexpr std::int32_t kMeanLimit = 1 << 26;   // 1 km at a step of 0.015 mm; sums of two fit in 32 bits
constexpr std::int32_t kValueLimit = 1 << 14;  // log-scales, colors, coefficients
constexpr std::int32_t kRotationLimit = 1 << 12;

ParameterLayout canonical(ParameterLayout parameters) {
  if (parameters.appearance == Appearance::Transfer) parameters.sh_degree = ParameterLayout{}.sh_degree;
  return parameters;
}

}  // namespace

StreamLayout::StreamLayout(const ParameterLayout& parameters, float mean_step_m) : parameters_(canonical(parameters)) {
  add(Attribute::Mean, 3, {0, mean_step_m}, -kMeanLimit, kMeanLimit);
  add(Attribute::LogScale, 3, {0, 1.0F / 64}, -kValueLimit, kValueLimit);
  add(Attribute::Rotation, 3, {0, 1.0F / 128}, -kRotationLimit, kRotationLimit);
  add(Attribute::Opacity, 1, {0, 1.0F / 255}, 0, 255);
  if (parameters.appearance == Appearance::Transfer) {
    add(Attribute::Albedo, 3, {0, 1.0F / 255}, -kValueLimit, kValueLimit);
    add(Attribute::Residual, 27, {0, 1.0F / 128}, -kValueLimit, kValueLimit);
    add(Attribute::Normal, 2, {0, 1.0F / 512}, -512, 512);
    add(Attribute::Visibility, 1, {0, 1.0F / 255}, 0, 255);
  } else {
    add(Attribute::ShDc, 3, {0, 1.0F / 72}, -kValueLimit, kValueLimit);  // a step is 1/255 of display white
    const int rest = 3 * (parameters.sh_coefficients() - 1);
    if (rest > 0) add(Attribute::ShRest, rest, {0, 1.0F / 64}, -kValueLimit, kValueLimit);
  }
}

bool StreamLayout::carries(const ParameterLayout& parameters) const {
  return parameters_ == canonical(parameters);
}

void StreamLayout::add(Attribute attribute, int channels, Quantizer quantizer, std::int32_t minimum,
                       std::int32_t maximum) {
  attributes_.push_back({attribute, channels_, channels, minimum, maximum, quantizer});
  channels_ += channels;
}

const AttributeChannels* StreamLayout::find(Attribute attribute) const {
  const auto found = std::find_if(attributes_.begin(), attributes_.end(),
                                  [&](const AttributeChannels& a) { return a.attribute == attribute; });
  return found == attributes_.end() ? nullptr : &*found;
}

const AttributeChannels& StreamLayout::at(Attribute attribute) const {
  const AttributeChannels* found = find(attribute);
  assert(found);
  return *found;
}

StreamLayout StreamLayout::from_wire(const wire::Layout& wired) {
  ParameterLayout parameters;
  switch (wired.appearance()) {
    case wire::Appearance::Transfer:
      parameters.appearance = Appearance::Transfer;
      break;
    case wire::Appearance::Radiance:
      parameters.appearance = Appearance::Radiance;
      break;
    default:
      throw StreamError(fmt::format("Layout: unknown appearance {}", static_cast<int>(wired.appearance())));
  }
  if (parameters.appearance == Appearance::Radiance) {
    if (wired.sh_degree() > 3) throw StreamError(fmt::format("Layout: sh_degree {} above 3", wired.sh_degree()));
    parameters.sh_degree = wired.sh_degree();
  }
  if (wired.page_lanes() != kPageLanes) {
    throw StreamError(
        fmt::format("Layout: pages of {} Gaussians; this build reads {}", wired.page_lanes(), kPageLanes));
  }
  StreamLayout layout(parameters, 1.0F);
  if (wired.attributes()->size() != layout.attributes_.size()) {
    throw StreamError(fmt::format("Layout: {} attributes where the layout has {}", wired.attributes()->size(),
                                  layout.attributes_.size()));
  }
  for (std::size_t i = 0; i < layout.attributes_.size(); ++i) {
    AttributeChannels& expected = layout.attributes_[i];
    const wire::TensorMetadata& said = *wired.attributes()->Get(static_cast<flatbuffers::uoffset_t>(i));
    const wire::Quantizer* quantizer = said.quantizer();
    if (said.attribute() != expected.attribute || said.channels() != static_cast<std::uint32_t>(expected.channels) ||
        !quantizer) {
      throw StreamError(fmt::format("Layout: attribute {} is not {} with {} channels", i,
                                    wire::EnumNameAttribute(expected.attribute), expected.channels));
    }
    const Quantizer q{quantizer->offset(), quantizer->step()};
    if (!std::isfinite(q.offset) || !std::isfinite(q.step) || std::abs(q.offset) > 1e6F || q.step < 1e-9F ||
        q.step > 1e3F) {
      throw StreamError(fmt::format("Layout: quantizer of {} makes no sense (offset {}, step {})",
                                    wire::EnumNameAttribute(expected.attribute), q.offset, q.step));
    }
    expected.quantizer = q;
  }
  return layout;
}

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

float mean_step_for(float median_log_extent) {
  const float exponent = std::floor(median_log_extent / std::log(2.0F)) - 5;
  return std::ldexp(1.0F, static_cast<int>(std::clamp(exponent, -20.0F, 0.0F)));
}

}  // namespace splatbus::stream
