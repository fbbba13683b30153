#include "raster/adam.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <iterator>
#include <stdexcept>
#include <utility>

#include "device/large_pages.h"
#include "gaussians/portable.h"
#include "raster/adam_kernel.h"
#include "raster/cpu/pieces.h"

namespace splatbus::raster {

namespace {

constexpr std::size_t kArenaPages = 16;

}  // namespace

std::size_t Adam::block_floats() const {
  return rows() * kRowWords;
}

float Adam::second_bias(const float* counters, std::size_t lane) const {
  return 1 - std::pow(beta2, static_cast<float>(reinterpret_cast<const std::uint32_t*>(counters)[lane]));
}

float* Adam::own_block(std::size_t page) {
  Page& of = pages_[page];
  if (of.block != nullptr) return of.block;
  if (free_blocks_.empty()) {
    arenas_.emplace_back(static_cast<float*>(device::allocate_large(kArenaPages * block_floats() * sizeof(float))));
    for (std::size_t k = kArenaPages; k-- > 0;) free_blocks_.push_back(arenas_.back().get() + k * block_floats());
  }
  of.block = free_blocks_.back();
  free_blocks_.pop_back();
  ++blocks_in_use_;
  std::memset(of.block, 0, block_floats() * sizeof(float));
  if (of.rest.empty()) return of.block;
  float* const counters = of.block + 2 * channels() * kRowWords;
  std::copy_n(of.rest.data() + channels(), kCounters * kRowWords, counters);
  for (std::size_t lane = 0; lane < kPageLanes; ++lane) {
    const float bias = second_bias(counters, lane);
    for (std::size_t c = 0; c < channels(); ++c) of.block[(channels() + c) * kRowWords + lane] = bias * of.rest[c];
  }
  of.rest = {};
  return of.block;
}

void Adam::release(std::size_t page) {
  Page& of = pages_[page];
  of.rest = {};
  if (of.block == nullptr) return;
  free_blocks_.push_back(std::exchange(of.block, nullptr));
  --blocks_in_use_;
}

void Adam::rest(std::size_t page) {
  Page& of = pages_[page];
  if (of.block == nullptr) return;
  const float* const counters = of.block + 2 * channels() * kRowWords;
  std::vector<float> rest(channels() + kCounters * kRowWords);
  for (std::size_t c = 0; c < channels(); ++c) {
    const float* const second = of.block + (channels() + c) * kRowWords;
    double sum = 0;
    std::size_t trained = 0;
    for (std::size_t lane = 0; lane < kPageLanes; ++lane) {
      const float bias = second_bias(counters, lane);
      if (!(bias > 0)) continue;
      sum += second[lane] / bias;
      ++trained;
    }
    rest[c] = trained > 0 ? static_cast<float>(sum / static_cast<double>(trained)) : 0.0F;
  }
  std::copy_n(counters, kCounters * kRowWords, rest.data() + channels());
  release(page);
  of.rest = std::move(rest);
}

void Adam::keep(std::span<const IndexRange> ranges) {
  std::size_t page = 0;
  for (const IndexRange& range : ranges) {
    for (; page < range.first >> kPageShift; ++page) release(page);
    if (range.frozen != 0) rest(page);
    ++page;
  }
  for (; page < pages_.size(); ++page) release(page);
}

PageMoments Adam::moments_of(std::size_t page) const {
  if (page >= pages_.size()) return PageMoments::None;
  if (pages_[page].block != nullptr) return PageMoments::Trains;
  return pages_[page].rest.empty() ? PageMoments::None : PageMoments::Rests;
}

void Adam::save(std::size_t page, float* moments) const {
  const Page& of = pages_[page];
  const bool rests = of.block == nullptr;
  if (rests) moments = std::copy_n(of.rest.data(), channels(), moments);
  const float* row = rests ? of.rest.data() + channels() : of.block;
  for (std::size_t left = rests ? kCounters : rows(); left-- > 0; row += kRowWords) {
    moments = std::copy_n(row, kPageLanes, moments);
  }
}

void Adam::restore(std::size_t page, PageMoments kind, const float* moments) {
  if (kind == PageMoments::None || page >= pages_.size()) return;
  release(page);
  Page& of = pages_[page];
  const bool rests = kind == PageMoments::Rests;
  if (rests) {
    of.rest.assign(channels() + kCounters * kRowWords, 0.0F);
    std::copy_n(moments, channels(), of.rest.data());
    moments += channels();
  }
  float* row = rests ? of.rest.data() + channels() : own_block(page);
  for (std::size_t left = rests ? kCounters : rows(); left-- > 0; row += kRowWords, moments += kPageLanes) {
    std::copy_n(moments, kPageLanes, row);
  }
}

void Adam::prepare(std::span<const IndexRange> ranges) {
  for (const IndexRange& range : ranges) own_block(range.first >> kPageShift);
}

void Adam::resize(const ParameterLayout& layout, std::size_t count) {
  if (layout != layout_) {
    pages_.clear();
    free_blocks_.clear();
    arenas_.clear();
    count_ = blocks_in_use_ = 0;
    layout_ = layout;
  }
  if (count < count_) reset(count, count_ - count);  // those that come back begin anew
  count_ = count;
  pages_.resize(std::max(pages_.size(), (count + kPageLanes - 1) / kPageLanes));
}

void Adam::reset(std::size_t first, std::size_t count) {
  for (std::size_t i = first; i < first + count;) {
    const std::size_t lane = i % kPageLanes;
    const std::size_t lanes = std::min<std::size_t>(kPageLanes - lane, first + count - i);
    Page& page = pages_[i >> kPageShift];
    if (!page.rest.empty()) own_block(i >> kPageShift);
    for (std::size_t c = 0; c < rows() && page.block != nullptr; ++c) {
      std::fill_n(page.block + c * kRowWords + lane, lanes, 0.0F);
    }
    i += lanes;
  }
}

void Adam::move(std::span<const std::uint32_t> from, std::span<const std::uint32_t> to) {
  if (from.size() != to.size()) throw std::invalid_argument("Adam: a move needs as many targets as sources");
  for (std::size_t k = 0; k < from.size(); ++k) {
    if (from[k] >= count_ || to[k] >= count_) throw std::invalid_argument("Adam: a Gaussian that moves does not exist");
    const float* const source = own_block(from[k] >> kPageShift) + from[k] % kPageLanes;
    float* const target = own_block(to[k] >> kPageShift) + to[k] % kPageLanes;
    for (std::size_t c = 0; c < rows(); ++c) target[c * kRowWords] = source[c * kRowWords];
  }
}

void Adam::check(const ParameterGradient& gradient, const std::vector<float>& learning_rate) const {
  if (gradient.layout != layout_ || gradient.count != count_) {
    throw std::invalid_argument("Adam: resize() has not followed the model");
  }
  if (learning_rate.size() != static_cast<std::size_t>(layout_.channels())) {
    throw std::invalid_argument("Adam: one learning rate a channel is needed");
  }
}

void Adam::look(const GaussiansView& gaussians, std::size_t begin, AdamStep& step) const {
  std::uint32_t frame_id = kWorldFrame;
  if (gaussians.has_pages()) {
    const auto after = std::upper_bound(gaussians.ranges.begin(), gaussians.ranges.end(), begin,
                                        [](std::size_t i, const IndexRange& range) { return i < range.first; });
    if (after != gaussians.ranges.begin()) frame_id = std::prev(after)->frame_id;
  }
  for (const AdamView& view : views) {
    step.loss_has_risen = step.loss_has_risen || view.loss_has_risen;
    if (step.distance_count == kMaxDistances) continue;
    math::Similarity world_from_frame = portable(ObjectTransform());
    if (frame_id != kWorldFrame) {
      const auto object = view.objects->find(frame_id);
      if (object == view.objects->end()) continue;
      world_from_frame = portable(seen_from(view.camera.world_from_camera.translation, frame_id, object->second));
    }
    const Rigid camera_from_world = inverse(view.camera.world_from_camera);
    const math::Rigid rigid = portable(camera_from_world);
    const math::Similarity camera_from_frame =
        math::Similarity{rigid.rotation, rigid.translation, 1} * world_from_frame;
    const math::Mat3& r = camera_from_frame.rotation;
    const float scale = camera_from_frame.scale;
    step.distances[step.distance_count++] = {scale * r.x.z, scale * r.y.z, scale * r.z.z,
                                             camera_from_frame.translation.z, view.camera.fx};
  }
}

AdamStep Adam::piece(const GaussiansView& gaussians, float* parameters, const ParameterGradient& gradient,
                     const std::vector<float>& learning_rate, std::size_t begin) const {
  const int channels = layout_.channels();
  float* const moments = block(begin >> kPageShift) + begin % kPageLanes;
  float* const counters = moments + 2 * static_cast<std::size_t>(channels) * kRowWords;
  AdamStep step{.channels = gradient.active_channels > 0 ? std::min(gradient.active_channels, channels) : channels,
                .stride = gaussians.stride,
                .gradient_stride = gradient.stride,
                .moment_stride = kRowWords,
                .parameters = parameters + gaussians.offset(begin),
                .gradient = gradient.values.empty() ? nullptr : gradient.values.data() + begin,
                .touched = gradient.touched.data() + begin,
                .flags = gaussians.flags == nullptr ? nullptr : gaussians.flags + gaussians.offset(begin),
                .learning_rate = learning_rate.data(),
                .first = moments,
                .second = moments + static_cast<std::size_t>(channels) * kRowWords,
                .steps = reinterpret_cast<std::uint32_t*>(counters),
                .near_steps = counters + kRowWords,
                .detail = counters + std::size_t{2} * kRowWords,
                .beta1 = beta1,
                .beta2 = beta2,
                .epsilon = epsilon,
                .lr_half_life_steps = lr_half_life_steps,
                .lr_min_factor = lr_min_factor,
                .unit_begin = unit_albedo ? ParameterLayout::kAlbedo : 0,
                .unit_end = unit_albedo ? ParameterLayout::kAlbedo + 3 : 0};
  look(gaussians, begin, step);
  return step;
}

void Adam::step(const GaussiansView& gaussians, float* parameters, const ParameterGradient& gradient,
                const std::vector<float>& learning_rate, int threads) {
  check(gradient, learning_rate);
  std::vector<IndexRange> pieces;
  cpu::cut_pieces(gaussians, kAdamPiece, pieces);
  std::erase_if(pieces, [](const IndexRange& piece) { return piece.frozen != 0; });
  prepare(pieces);
  cpu::Workers(threads).for_pieces(pieces.size(), 1, [&](std::size_t k, std::size_t) {
    adam_range(piece(gaussians, parameters, gradient, learning_rate, pieces[k].first), pieces[k].count);
  });
}

}  // namespace splatbus::raster
