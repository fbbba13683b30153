#include "raster/loss.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "gaussians/light.h"
#include "raster/cpu/scratch.h"
#include "raster/cpu/workers.h"
#include "raster/loss_kernel.h"

namespace splatbus::raster {
namespace {

/// Rows that one thread goes through; ten above and below are worked out again.
constexpr std::uint32_t kBandRows = 64;

}  // namespace

float image_loss(const Image& rendered, const std::uint8_t* target_rgba, const LossOptions& options, Image& gradient) {
  if (rendered.channels != 3) throw std::invalid_argument("image_loss: three planes are needed");
  const std::size_t pixels = std::size_t{rendered.width} * rendered.height;
  gradient.width = rendered.width;
  gradient.height = rendered.height;
  gradient.channels = 3;
  gradient.data.resize(3 * pixels);
  if (pixels == 0) return 0;

  const auto inverse_count = 1.0F / static_cast<float>(3 * pixels);
  const std::uint32_t bands = (rendered.height + kBandRows - 1) / kBandRows;
  std::vector<LossSums> sums(std::size_t{3} * bands);
  cpu::Workers(options.threads).for_pieces(sums.size(), 1, [&](std::size_t k, std::size_t) {
    LossChannel channel;
    channel.width = rendered.width;
    channel.height = rendered.height;
    channel.channel = static_cast<std::uint32_t>(k / bands);
    channel.encode_srgb = options.encode_srgb;
    channel.ssim_scale = options.ssim_weight * inverse_count;
    channel.l1_scale = (1 - options.ssim_weight) * inverse_count;
    channel.rendered = rendered.plane(channel.channel);
    channel.target_rgba = target_rgba;
    channel.mask = options.mask;
    channel.gradient = gradient.plane(channel.channel);
    const std::uint32_t begin = static_cast<std::uint32_t>(k % bands) * kBandRows;
    thread_local cpu::Scratch<float> scratch;
    scratch.reserve(loss_scratch_floats(rendered.width));
    sums[k] = loss_rows(channel, begin, std::min(rendered.height, begin + kBandRows), scratch.data());
  });

  double l1 = 0, ssim = 0;
  for (const LossSums& sum : sums) {
    l1 += sum.l1;
    ssim += sum.ssim;
  }
  const auto count = static_cast<double>(3 * pixels);
  return static_cast<float>((1 - options.ssim_weight) * l1 / count + options.ssim_weight * (1 - ssim / count));
}

void l1_error(const Image& rendered, const std::uint8_t* target_rgba, bool encode_srgb, const std::uint8_t* mask,
              Image& error) {
  constexpr int kSteps = 4096;
  static const std::vector<float> kCurve = [] {
    std::vector<float> curve(kSteps + 1);
    for (int k = 0; k <= kSteps; ++k)
      curve[static_cast<std::size_t>(k)] = srgb_from_linear(static_cast<float>(k) / kSteps);
    return curve;
  }();
  error.width = rendered.width;
  error.height = rendered.height;
  error.channels = 1;
  const std::size_t pixels = std::size_t{rendered.width} * rendered.height;
  error.data.assign(pixels, 0.0F);
  for (std::uint32_t c = 0; c < 3; ++c) {
    const float* const plane = rendered.plane(c);
    for (std::size_t i = 0; i < pixels; ++i) {
      const float clamped = plane[i] > 0 ? std::min(plane[i], 1.0F) : 0.0F;
      const float entry = clamped * kSteps + 0.5F;
      const float shown = encode_srgb ? kCurve[static_cast<std::size_t>(entry)] : clamped;
      error.data[i] += (1.0F / 3) * std::abs(shown - (1.0F / 255) * static_cast<float>(target_rgba[4 * i + c]));
    }
  }
  for (std::size_t i = 0; mask != nullptr && i < pixels; ++i) {
    if (mask[i] != 0) error.data[i] = -1;
  }
}

}  // namespace splatbus::raster
