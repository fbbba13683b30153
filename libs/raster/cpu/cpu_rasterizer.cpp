#include "raster/cpu/cpu_rasterizer.h"

#include <algorithm>
#include <chrono>
#include <numeric>
#include <stdexcept>

#include "raster/adam.h"
#include "raster/adam_kernel.h"
#include "raster/cpu/kernels.h"

namespace splatbus::raster {
namespace cpu {
namespace {

constexpr std::size_t kGaussianPiece = 2048;  // a multiple of any vector's lanes
constexpr std::size_t kTilePiece = 8, kWideTilePiece = 4;

void resize(Image& image, const Camera& camera, std::uint32_t channels) {
  image.width = channels == 0 ? 0 : camera.width;
  image.height = channels == 0 ? 0 : camera.height;
  image.channels = channels;
  image.data.resize(std::size_t{image.width} * image.height * channels);
}

/// Runs one stage and notes its time.
template <class Body>
void timed(std::vector<StageTime>& times, const char* name, const Body& body) {
  const auto begin = std::chrono::steady_clock::now();
  body();
  times.push_back({name, std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin).count()});
}

void check(const GaussiansView& gaussians, const Camera& camera) {
  if (gaussians.count > kGaussianMask) throw std::invalid_argument("rasterizer: more than 2^28 Gaussians");
  if (gaussians.count > gaussians.stride) throw std::invalid_argument("rasterizer: stride is below count");
  if (gaussians.count > 0 && gaussians.parameters == nullptr) throw std::invalid_argument("rasterizer: no parameters");
  if (camera.role == CameraRole::Light) throw std::invalid_argument("rasterizer: light cameras are orthographic");
  constexpr std::uint32_t kMaxSide = 1U << 15U;
  if (camera.width > kMaxSide || camera.height > kMaxSide) throw std::invalid_argument("rasterizer: picture too large");
}

}  // namespace

void CpuRasterizer::project() {
  const std::size_t count = frame_.gaussians.count;
  const std::size_t pieces = (count + kGaussianPiece - 1) / kGaussianPiece;
  frame_.splats.reserve(count);
  frame_.reaches.reserve(count);
  if (frame_.keep) frame_.pair_ranges.reserve(count);
  frame_.order.reserve(count);
  spare_keys_.reserve(count);
  visible_of_piece_.assign(pieces, 0);
  // Every piece leaves its keys at its own place; they are then closed up.
  workers_.for_pieces(count, kGaussianPiece, [&](std::size_t begin, std::size_t end) {
    visible_of_piece_[begin / kGaussianPiece] = project_range(frame_, begin, end, spare_keys_.data() + begin);
  });
  first_of_piece_.resize(pieces);
  std::exclusive_scan(visible_of_piece_.begin(), visible_of_piece_.end(), first_of_piece_.begin(), std::size_t{0});
  frame_.visible = pieces == 0 ? 0 : first_of_piece_.back() + visible_of_piece_.back();
  workers_.for_pieces(count, kGaussianPiece, [&](std::size_t begin, std::size_t) {
    const std::size_t piece = begin / kGaussianPiece;
    std::copy_n(spare_keys_.data() + begin, visible_of_piece_[piece], frame_.order.data() + first_of_piece_[piece]);
  });
}

void CpuRasterizer::run_forward(const GaussiansView& gaussians, const Camera& camera, const SceneState& scene,
                                const RenderOptions& options, bool keep, Render& out) {
  check(gaussians, camera);
  frame_.keep = keep;
  frame_.gaussians = gaussians;
  frame_.camera = camera;
  frame_.options = options;
  if (gaussians.layout.appearance != Appearance::Transfer) frame_.options.albedo = false;
  frame_.objects.build(camera, scene);
  for (int c = 0; c < 3; ++c) {
    const float background = scene.light.background[c];
    frame_.background[c] =
        gaussians.layout.appearance == Appearance::Radiance ? srgb_from_linear(background) : background;
  }
  // gsplat's form of 3DGS's clamp: 0.3 of the half field of view beyond the picture's sides, wherever its centre is.
  const float half_x = 0.5F * static_cast<float>(camera.width) / camera.fx;
  const float half_y = 0.5F * static_cast<float>(camera.height) / camera.fy;
  frame_.tan_limit_x_low = -camera.cx / camera.fx - 0.3F * half_x;
  frame_.tan_limit_x_high = (static_cast<float>(camera.width) - camera.cx) / camera.fx + 0.3F * half_x;
  frame_.tan_limit_y_low = -camera.cy / camera.fy - 0.3F * half_y;
  frame_.tan_limit_y_high = (static_cast<float>(camera.height) - camera.cy) / camera.fy + 0.3F * half_y;
  const std::uint32_t side = tile_side(keep);
  frame_.tiles_x = (camera.width + side - 1) / side;
  frame_.tiles_y = (camera.height + side - 1) / side;

  resize(out.color, camera, 3);
  resize(out.alpha, camera, 1);
  resize(out.albedo, camera, frame_.options.albedo ? 3 : 0);
  resize(out.depth, camera, options.depth ? 1 : 0);

  forward_times_.clear();
  timed(forward_times_, "project", [&] { project(); });
  timed(forward_times_, "sort", [&] { sorter_.sort(frame_.order, spare_keys_, frame_.visible, workers_); });
  timed(forward_times_, "bin", [&] { binner_.bin(frame_, workers_); });
  const std::size_t tiles = frame_.tile_count();
  if (keep) {
    frame_.transmittance.reserve(tiles * kTilePixels);
    frame_.last_entry.reserve(tiles * kTilePixels);
    frame_.block_entries.reserve(tiles * kTileBlocks);
  }
  timed(forward_times_, "blend", [&] {
    workers_.for_pieces(tiles, keep ? kTilePiece : kWideTilePiece, [&](std::size_t begin, std::size_t end) {
      for (std::size_t tile = begin; tile < end; ++tile) blend_tile(frame_, static_cast<std::uint32_t>(tile), out);
    });
  });
}

std::vector<StageTime> CpuRasterizer::stage_times() const {
  std::vector<StageTime> times = forward_times_;
  times.insert(times.end(), backward_times_.begin(), backward_times_.end());
  return times;
}

void CpuRasterizer::forward(const GaussiansView& gaussians, const Camera& camera, const SceneState& scene,
                            const RenderOptions& options, Render& out) {
  run_forward(gaussians, camera, scene, options, true, out);
}

void CpuRasterizer::render(const GaussiansView& gaussians, const Camera& camera, const SceneState& scene,
                           const RenderOptions& options, Render& out) {
  run_forward(gaussians, camera, scene, options, false, out);
}

void CpuRasterizer::blend_backward(const RenderGradient& gradient) {
  const auto fits = [&](const Image& image, std::uint32_t channels) {
    return image.channels == 0 ||
           (image.channels == channels && image.width == frame_.camera.width && image.height == frame_.camera.height);
  };
  if (!fits(gradient.color, 3) || !fits(gradient.alpha, 1) || !fits(gradient.albedo, 3) || !fits(gradient.depth, 1)) {
    throw std::invalid_argument("rasterizer: a gradient's size is not that of the render");
  }
  frame_.pair_gradients.reserve(frame_.pairs);
  frame_.pair_written.reserve(frame_.pairs);
  workers_.for_pieces(frame_.tile_count(), kTilePiece, [&](std::size_t begin, std::size_t end) {
    for (std::size_t tile = begin; tile < end; ++tile) {
      blend_tile_backward(frame_, static_cast<std::uint32_t>(tile), gradient);
    }
  });
}

GradientTarget CpuRasterizer::target_of(ParameterGradient& out) const {
  if (!frame_.keep) throw std::invalid_argument("rasterizer: backward() without forward()");
  const GaussiansView& gaussians = frame_.gaussians;
  if (out.count != gaussians.count || out.stride != gaussians.stride || out.layout != gaussians.layout) {
    throw std::invalid_argument("rasterizer: the gradient was not cleared for these Gaussians");
  }
  const int channels = out.layout.channels();
  const int active = out.active_channels > 0 ? std::min(out.active_channels, channels) : channels;
  return {out.values.data(),      out.stride, 0, true, active, out.touched.data(), out.mean2d_norm.data(),
          out.contribution.data()};
}

void CpuRasterizer::backward(const RenderGradient& gradient, ParameterGradient& out) {
  const GradientTarget target = target_of(out);
  if (out.values.size() < static_cast<std::size_t>(out.layout.channels()) * out.stride) {
    throw std::invalid_argument("rasterizer: the gradient has no room for values");
  }
  backward_times_.clear();
  timed(backward_times_, "blend_backward", [&] { blend_backward(gradient); });
  timed(backward_times_, "project_backward", [&] {
    workers_.for_pieces(frame_.gaussians.count, kGaussianPiece, [&](std::size_t begin, std::size_t end) {
      project_range_backward(frame_, begin, end, target);
    });
  });
}

void CpuRasterizer::backward_step(const RenderGradient& gradient, const std::vector<float>& learning_rate, Adam& adam,
                                  float* parameters, ParameterGradient& statistics) {
  const GradientTarget target = target_of(statistics);
  const GaussiansView& gaussians = frame_.gaussians;
  AdamStep step = adam.prepare(statistics, learning_rate);
  step.parameters = parameters;
  step.flags = gaussians.flags;
  backward_times_.clear();
  timed(backward_times_, "blend_backward", [&] { blend_backward(gradient); });
  timed(backward_times_, "project_backward_adam", [&] {
    workers_.for_pieces(gaussians.count, kAdamPiece, [&](std::size_t begin, std::size_t end) {
      thread_local Scratch<float> values;
      values.reserve(static_cast<std::size_t>(target.active_channels) * kAdamPiece);
      GradientTarget piece = target;
      piece.values = values.data();
      piece.stride = kAdamPiece;
      piece.origin = begin;
      piece.zeroed = false;
      project_range_backward(frame_, begin, end, piece);
      AdamStep piece_step = step;
      piece_step.gradient = values.data();
      piece_step.gradient_stride = kAdamPiece;
      piece_step.gradient_origin = begin;
      adam_range(piece_step, begin, end);
    });
  });
}

}  // namespace cpu

std::unique_ptr<Rasterizer> make_cpu_rasterizer(int threads) {
  return std::make_unique<cpu::CpuRasterizer>(threads);
}

}  // namespace splatbus::raster
