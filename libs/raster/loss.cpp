#include "raster/loss.h"

#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <stdexcept>
#include <vector>

#include "raster/loss_kernel.h"

namespace splatbus::raster {
namespace {

constexpr std::uint32_t kBandRows = 16;
constexpr std::uint32_t kScratchPlanes = 10;  // of a channel: x, y, 5 blurred, 3 gradients

struct Band {
  std::uint32_t channel, begin, end;
};

}  // namespace

float image_loss(const Image& rendered, const std::uint8_t* target_rgba, const LossOptions& options, Image& gradient) {
  if (rendered.channels != 3) throw std::invalid_argument("image_loss: three planes are needed");
  const std::size_t pixels = std::size_t{rendered.width} * rendered.height;
  gradient.width = rendered.width;
  gradient.height = rendered.height;
  gradient.channels = 3;
  gradient.data.resize(3 * pixels);
  if (pixels == 0) return 0;

  thread_local std::vector<float> scratch;
  scratch.resize(std::size_t{3} * kScratchPlanes * pixels);
  const auto inverse_count = 1.0F / static_cast<float>(3 * pixels);
  std::vector<LossChannel> channels(3);
  for (std::uint32_t c = 0; c < 3; ++c) {
    LossChannel& channel = channels[c];
    channel.width = rendered.width;
    channel.height = rendered.height;
    channel.channel = c;
    channel.encode_srgb = options.encode_srgb;
    channel.ssim_scale = options.ssim_weight * inverse_count;
    channel.l1_scale = (1 - options.ssim_weight) * inverse_count;
    channel.rendered = rendered.plane(c);
    channel.target_rgba = target_rgba;
    float* plane = scratch.data() + std::size_t{c} * kScratchPlanes * pixels;
    channel.shown = plane;
    channel.target = plane + pixels;
    for (std::size_t k = 0; k < 5; ++k) channel.row_blurred[k] = plane + (2 + k) * pixels;
    for (std::size_t k = 0; k < 3; ++k) channel.row_gradients[k] = plane + (7 + k) * pixels;
    channel.gradient = gradient.plane(c);
  }

  std::vector<Band> bands;
  for (std::uint32_t c = 0; c < 3; ++c) {
    for (std::uint32_t y = 0; y < rendered.height; y += kBandRows) {
      bands.push_back({c, y, std::min(rendered.height, y + kBandRows)});
    }
  }
  std::vector<LossSums> sums(bands.size());
  // Isolated: while a thread waits here it must not take up another loss, whose scratch memory would be the same.
  const auto for_bands = [&](auto&& pass) {
    tbb::this_task_arena::isolate([&] {
      tbb::parallel_for(std::size_t{0}, bands.size(),
                        [&](std::size_t k) { pass(k, channels[bands[k].channel], bands[k]); });
    });
  };
  for_bands(
      [](std::size_t, const LossChannel& channel, const Band& band) { loss_blur_rows(channel, band.begin, band.end); });
  for_bands([&](std::size_t k, const LossChannel& channel, const Band& band) {
    sums[k] = loss_ssim_rows(channel, band.begin, band.end);
  });
  for_bands([](std::size_t, const LossChannel& channel, const Band& band) {
    loss_gradient_rows(channel, band.begin, band.end);
  });

  double l1 = 0, ssim = 0;
  for (const LossSums& sum : sums) {
    l1 += sum.l1;
    ssim += sum.ssim;
  }
  const auto count = static_cast<double>(3 * pixels);
  return static_cast<float>((1 - options.ssim_weight) * l1 / count + options.ssim_weight * (1 - ssim / count));
}

}  // namespace splatbus::raster
