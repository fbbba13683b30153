#include "raster/loss.h"

#include <algorithm>
#include <stdexcept>
#include <utility>
#include <vector>

#include "raster/cpu/scratch.h"
#include "raster/cpu/workers.h"
#include "raster/loss_kernel.h"

namespace splatbus::raster {
namespace {

constexpr std::uint32_t kBandRows = 32;
/// Rows around a band that its passes work out again: SSIM's gradient looks at what looks at the picture.
constexpr std::uint32_t kSurround = 2 * kSsimRadius;
constexpr std::size_t kPlanes = 10;  // x, y, 5 blurred, 3 gradients

std::uint32_t rows_before(std::uint32_t row, std::uint32_t rows) {
  return row > rows ? row - rows : 0;
}

/// All passes over one band of a channel; the planes between them never leave the cache.
LossSums band_loss(LossBand band, std::uint32_t begin, std::uint32_t end) {
  const std::uint32_t last_row = std::min(end + kSurround, band.height);
  band.first_row = rows_before(begin, kSurround);
  thread_local cpu::Scratch<float> scratch;
  const std::size_t pixels = std::size_t{last_row - band.first_row} * band.width;
  scratch.reserve(kPlanes * pixels);
  float* plane = scratch.data();
  const auto next_plane = [&] { return std::exchange(plane, plane + pixels); };
  band.shown = next_plane();
  band.target = next_plane();
  for (float*& blurred : band.row_blurred) blurred = next_plane();
  for (float*& gradient : band.row_gradients) gradient = next_plane();

  loss_blur_rows(band, band.first_row, last_row);
  const std::uint32_t above = rows_before(begin, kSsimRadius);
  const std::uint32_t below = std::min(end + kSsimRadius, band.height);
  (void)loss_ssim_rows(band, above, begin);
  const LossSums sums = loss_ssim_rows(band, begin, end);
  (void)loss_ssim_rows(band, end, below);
  loss_gradient_rows(band, begin, end);
  return sums;
}

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
    LossBand band;
    band.width = rendered.width;
    band.height = rendered.height;
    band.channel = static_cast<std::uint32_t>(k / bands);
    band.encode_srgb = options.encode_srgb;
    band.ssim_scale = options.ssim_weight * inverse_count;
    band.l1_scale = (1 - options.ssim_weight) * inverse_count;
    band.rendered = rendered.plane(band.channel);
    band.target_rgba = target_rgba;
    band.gradient = gradient.plane(band.channel);
    const std::uint32_t begin = static_cast<std::uint32_t>(k % bands) * kBandRows;
    sums[k] = band_loss(band, begin, std::min(rendered.height, begin + kBandRows));
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
