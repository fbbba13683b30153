#include "raster/cpu/cpu_rasterizer.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <functional>
#include <numeric>
#include <stdexcept>

#include "raster/adam.h"
#include "raster/adam_kernel.h"
#include "raster/cpu/kernels.h"
#include "raster/cpu/pieces.h"
#include "raster/unmodelled.h"

namespace splatbus::raster {
namespace cpu {
namespace {

constexpr std::uint32_t kGaussianPiece = 2048;  // a multiple of any vector's lanes
// A line more than a piece: as kRowWords.
constexpr std::size_t kGradientStride = kAdamPiece + 16;
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
  if (!gaussians.has_pages() && gaussians.count > gaussians.stride)
    throw std::invalid_argument("rasterizer: stride is below count");
  if (gaussians.count > 0 && gaussians.parameters == nullptr) throw std::invalid_argument("rasterizer: no parameters");
  if (camera.role == CameraRole::Light) throw std::invalid_argument("rasterizer: light cameras are orthographic");
  constexpr std::uint32_t kMaxSide = 1U << 15U;
  if (camera.width > kMaxSide || camera.height > kMaxSide) throw std::invalid_argument("rasterizer: picture too large");
}

bool is_frozen(const IndexRange& range) {
  return range.frozen != 0;
}

}  // namespace

void CpuRasterizer::list_pieces(const SceneState& scene) {
  GaussiansView shown = frame_.gaussians;
  if (!shown.bounds.empty()) {
    const Camera& camera = frame_.camera;
    const auto max_tan = [](float low, float high) { return std::max(std::abs(low), std::abs(high)); };
    const FrustumCamera pinhole{.fx = camera.fx,
                                .fy = camera.fy,
                                .cx = camera.cx,
                                .cy = camera.cy,
                                .width = static_cast<float>(camera.width),
                                .height = static_cast<float>(camera.height),
                                .near_m = camera.near_m,
                                .blur_px2 = frame_.options.blur_px2,
                                .max_tan_x = max_tan(frame_.tan_limit_x_low, frame_.tan_limit_x_high),
                                .max_tan_y = max_tan(frame_.tan_limit_y_low, frame_.tan_limit_y_high)};
    shown_ranges_ =
        select_ranges(shown, pinhole, camera.world_from_camera, scene.objects, frame_.options.hidden_behind);
    shown.ranges = shown_ranges_;
  }
  cut_pieces(shown, kGaussianPiece, frame_.pieces);
  frame_.frozen_page.clear();
  if (!std::ranges::any_of(frame_.pieces, is_frozen)) return;
  frame_.frozen_page.assign((frame_.gaussians.count >> frame_.gaussians.page_shift) + 1, 0);
  for (const IndexRange& piece : frame_.pieces) {
    frame_.frozen_page[piece.first >> frame_.gaussians.page_shift] = is_frozen(piece) ? 1 : 0;
  }
}

void CpuRasterizer::project() {
  const std::size_t count = frame_.gaussians.count;
  const std::size_t pieces = frame_.pieces.size();
  frame_.splats.reserve(count);
  frame_.reaches.reserve(count);
  if (frame_.keep) frame_.pair_ranges.reserve(count);
  room_of_piece_.resize(pieces);
  std::transform_exclusive_scan(frame_.pieces.begin(), frame_.pieces.end(), room_of_piece_.begin(), std::size_t{0},
                                std::plus<>(), [](const IndexRange& piece) { return std::size_t{piece.count}; });
  const std::size_t listed = pieces == 0 ? 0 : room_of_piece_.back() + frame_.pieces.back().count;
  frame_.order.reserve(listed);
  spare_keys_.reserve(listed);
  visible_of_piece_.assign(pieces, 0);
  // Every piece leaves its keys at its own place; they are then closed up.
  workers_.for_pieces(pieces, 1, [&](std::size_t piece, std::size_t) {
    visible_of_piece_[piece] = project_range(frame_, frame_.pieces[piece], spare_keys_.data() + room_of_piece_[piece]);
  });
  first_of_piece_.resize(pieces);
  std::exclusive_scan(visible_of_piece_.begin(), visible_of_piece_.end(), first_of_piece_.begin(), std::size_t{0});
  frame_.visible = pieces == 0 ? 0 : first_of_piece_.back() + visible_of_piece_.back();
  workers_.for_pieces(pieces, 1, [&](std::size_t piece, std::size_t) {
    std::copy_n(spare_keys_.data() + room_of_piece_[piece], visible_of_piece_[piece],
                frame_.order.data() + first_of_piece_[piece]);
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
  frame_.sources.clear();
  if (gaussians.layout.appearance == Appearance::Transfer) {
    frame_.sources = shading_sources(scene.light, inverse(camera.world_from_camera),
                                     {gaussians.visibility_u8, gaussians.visibility_stride, gaussians.visibility_rows});
  }
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
  timed(forward_times_, "project", [&] {
    list_pieces(scene);
    project();
  });
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
  if (out.count != gaussians.count || out.layout != gaussians.layout) {
    throw std::invalid_argument("rasterizer: the gradient was not cleared for these Gaussians");
  }
  const int channels = out.layout.channels();
  const int active = out.active_channels > 0 ? std::min(out.active_channels, channels) : channels;
  out.written.insert(out.written.end(), frame_.pieces.begin(), frame_.pieces.end());
  return {out.values.data(),      out.stride, 0, true, active, out.touched.data(), out.mean2d_norm.data(),
          out.contribution.data()};
}

void CpuRasterizer::backward(const RenderGradient& gradient, ParameterGradient& out) {
  const GradientTarget target = target_of(out);
  if (out.values.size() < static_cast<std::size_t>(out.layout.channels()) * out.stride) {
    throw std::invalid_argument("rasterizer: the gradient has no room for values");
  }
  backward_times_.clear();
  frame_.surface_depth = gradient.surface_depth;
  timed(backward_times_, "blend_backward", [&] { blend_backward(gradient); });
  timed(backward_times_, "project_backward", [&] {
    workers_.for_pieces(frame_.pieces.size(), 1, [&](std::size_t piece, std::size_t) {
      if (!is_frozen(frame_.pieces[piece])) project_range_backward(frame_, frame_.pieces[piece], target);
    });
  });
}

void CpuRasterizer::backward_step(const RenderGradient& gradient, const std::vector<float>& learning_rate, Adam& adam,
                                  float* parameters, ParameterGradient& statistics) {
  const GradientTarget target = target_of(statistics);
  const GaussiansView& gaussians = frame_.gaussians;
  adam.check(statistics, learning_rate);
  frame_.surface_depth = gradient.surface_depth;
  adam_pieces_.clear();
  GaussiansView shown = gaussians;
  if (gaussians.has_pages()) shown.ranges = frame_.pieces;
  cut_pieces(shown, kAdamPiece, adam_pieces_);
  std::erase_if(adam_pieces_, is_frozen);
  adam.prepare(adam_pieces_);
  backward_times_.clear();
  timed(backward_times_, "blend_backward", [&] { blend_backward(gradient); });
  timed(backward_times_, "project_backward_adam", [&] {
    workers_.for_pieces(adam_pieces_.size(), 1, [&](std::size_t k, std::size_t) {
      const IndexRange& piece = adam_pieces_[k];
      thread_local Scratch<float> values;
      values.reserve(static_cast<std::size_t>(target.active_channels) * kGradientStride);
      GradientTarget piece_target = target;
      piece_target.values = values.data();
      piece_target.stride = kGradientStride;
      piece_target.origin = piece.first;
      piece_target.zeroed = false;
      project_range_backward(frame_, piece, piece_target);
      AdamStep step = adam.piece(gaussians, parameters, statistics, learning_rate, piece.first);
      step.gradient = values.data();
      step.gradient_stride = kGradientStride;
      adam_range(step, piece.count);
    });
  });
}

void CpuRasterizer::look_at_pages(const Image& error, std::vector<PageLook>& looks) {
  if (!frame_.keep) throw std::invalid_argument("rasterizer: look_at_pages() without forward()");
  const Camera& camera = frame_.camera;
  if (error.channels != 1 || error.width != camera.width || error.height != camera.height) {
    throw std::invalid_argument("rasterizer: the errors' size is not that of the render");
  }
  looks.clear();
  page_sums_.assign((frame_.gaussians.count >> frame_.gaussians.page_shift) + 1, {});
  for (std::uint32_t tile = 0; tile < frame_.tile_count(); ++tile) {
    const std::uint32_t x0 = tile % frame_.tiles_x * kTileSide, y0 = tile / frame_.tiles_x * kTileSide;
    const std::uint32_t x1 = std::min(camera.width, x0 + kTileSide), y1 = std::min(camera.height, y0 + kTileSide);
    double sum = 0;
    std::uint32_t pixels = 0;
    for (std::uint32_t y = y0; y < y1; ++y) {
      for (std::uint32_t x = x0; x < x1; ++x) {
        const float value = error.data[std::size_t{y} * camera.width + x];
        if (!(value >= 0)) continue;
        sum += value;
        ++pixels;
      }
    }
    if (pixels == 0) continue;
    const std::uint32_t* const ends = frame_.block_entries.data() + std::size_t{tile} * kTileBlocks;
    const TileEntry* const entries = frame_.entries.data() + frame_.tile_begin[tile];
    const std::uint32_t end = *std::max_element(ends, ends + kTileBlocks);
    for (std::uint32_t k = 0; k < end; ++k) {
      PageLook& of = page_sums_[(entries[k] & kGaussianMask) >> frame_.gaussians.page_shift];
      of.error += sum / pixels;
      of.pairs += 1;
    }
  }
  for (std::uint32_t page = 0; page < page_sums_.size(); ++page) {
    const PageLook& sums = page_sums_[page];
    if (sums.pairs != 0) looks.push_back({page, sums.pairs, sums.error / sums.pairs});
  }
}

void CpuRasterizer::opacity_within(float distance_m, std::vector<float>& opacity) {
  if (!frame_.keep) throw std::invalid_argument("rasterizer: opacity_within() without forward()");
  static_assert(kTileSide == kUnmodelledSide);
  constexpr float kOpaque = 0.01F;  // transmittance
  const Camera& camera = frame_.camera;
  opacity.clear();
  const auto of_far_field = [](const IndexRange& piece) { return piece.frame_id == kFarFieldFrame; };
  if (frame_.gaussians.object_id == nullptr && std::ranges::none_of(frame_.pieces, of_far_field)) return;
  opacity.assign(std::size_t{frame_.tile_count()} * kUnmodelledSamples, 0.0F);
  const auto of_tile = [&](std::uint32_t tile) {
    const TileEntry* const entries = frame_.entries.data() + frame_.tile_begin[tile];
    const std::uint32_t count = frame_.tile_begin[tile + 1] - frame_.tile_begin[tile];
    for (int sample = 0; sample < kUnmodelledSamples; ++sample) {
      const auto offset = static_cast<std::uint32_t>(unmodelled_sample(sample));
      const std::uint32_t column = tile % frame_.tiles_x * kTileSide + offset,
                          row = tile / frame_.tiles_x * kTileSide + offset;
      if (column >= camera.width || row >= camera.height) continue;
      const float x = static_cast<float>(column) + 0.5F, y = static_cast<float>(row) + 0.5F;
      float transmittance = 1;
      for (std::uint32_t k = 0; k < count && transmittance > kOpaque; ++k) {
        const Splat& splat = frame_.splats[entries[k] & kGaussianMask];
        const float dx = x - splat.x, dy = y - splat.y;
        const float u = splat.uxx * dx + splat.uxy * dy, v = splat.uyy * dy;
        const float alpha = std::min(std::exp2(splat.log2_alpha - u * u - v * v), kAlphaMax);
        if (!(alpha >= kAlphaMin)) continue;
        const float tan_x = (splat.x - camera.cx) / camera.fx, tan_y = (splat.y - camera.cy) / camera.fy;
        if (splat.depth * std::sqrt(1 + tan_x * tan_x + tan_y * tan_y) >= distance_m) continue;
        transmittance *= 1 - alpha;
      }
      opacity[std::size_t{tile} * kUnmodelledSamples + static_cast<std::size_t>(sample)] = 1 - transmittance;
    }
  };
  constexpr std::size_t kTilesAPiece = 16;
  workers_.for_pieces(frame_.tile_count(), kTilesAPiece, [&](std::size_t begin, std::size_t end) {
    for (std::size_t tile = begin; tile < end; ++tile) of_tile(static_cast<std::uint32_t>(tile));
  });
}

}  // namespace cpu

std::unique_ptr<Rasterizer> make_cpu_rasterizer(int threads) {
  return std::make_unique<cpu::CpuRasterizer>(threads);
}

}  // namespace splatbus::raster
