#pragma once

#include <cstdint>
#include <cstdlib>
#include <memory>
#include <span>
#include <vector>

#include "gaussians/light.h"
#include "raster/rasterizer.h"

namespace splatbus::raster {

struct AdamStep;

/// What Adam keeps of a page: nothing; the moments of one that trains, [2 channels + 3][kPageLanes] (first moments,
/// second ones, steps as integers, LearningAge's two); or, of one that rests, mean second moments [channels] and the
/// three counters, [3][kPageLanes].
enum class PageMoments : std::uint32_t { None, Trains, Rests };
[[nodiscard]] constexpr std::size_t moment_floats(PageMoments kind, std::size_t channels) {
  constexpr std::size_t kCounters = 3;
  if (kind == PageMoments::None) return 0;
  return kind == PageMoments::Trains ? (2 * channels + kCounters) * kPageLanes : channels + kCounters * kPageLanes;
}

/// A view of a step, as far as Adam looks at it.
struct AdamView {
  Camera camera;
  const ObjectTransforms* objects = nullptr;  ///< of its scene
  bool loss_has_risen = false;                ///< as LossHistory says
};

/// Adam (Kingma and Ba 2015), only on Gaussians touched and not frozen (sparse, as Taming-3DGS and gsplat's
/// SelectiveAdam: untouched moments rest). One learning rate a channel. Moments lie in pages (gaussians/pages.h), in
/// blocks that a page gets when it first trains and gives back when it freezes or goes; arenas of them are added as
/// more are needed. Not thread-safe.
class Adam {
 public:
  float beta1 = 0.9F, beta2 = 0.999F, epsilon = 1e-15F;
  /// h and l: the rates of a Gaussian fall with its own age t (LearningAge), in steps, to max(l, h / (h + t)) of what
  /// they are; h 0: they stay.
  float lr_half_life_steps = 0, lr_min_factor = 0;
  bool unit_albedo = false;  ///< Transfer: albedo stays within [0, 1]
  /// Of the next step. Without any, every step ages by one.
  std::vector<AdamView> views;

  /// Room for indices below `count`; what is new is 0, what leaves is forgotten, as is everything when the layout
  /// changes.
  void resize(const ParameterLayout& layout, std::size_t count);
  /// Gaussians first, first + 1, ... begin anew.
  void reset(std::size_t first, std::size_t count);
  /// What was kept of from[k] is now that of to[k], in this order.
  void move(std::span<const std::uint32_t> from, std::span<const std::uint32_t> to);

  /// Pages of which `ranges`, ascending, have none are forgotten. Of frozen ones the ages stay, and of their moments a
  /// mean of the second ones a channel, with which they go on when they train again: their steps are then neither those
  /// of a beginner nor, without a second moment, without bounds.
  void keep(std::span<const IndexRange> ranges);
  /// Of the pages that hold these: room for what they learn next.
  void prepare(std::span<const IndexRange> ranges);
  /// Takes what is kept of a page somewhere else, and puts it in again: moment_floats() of them.
  [[nodiscard]] PageMoments moments_of(std::size_t page) const;
  void save(std::size_t page, float* moments) const;
  void restore(std::size_t page, PageMoments kind, const float* moments);
  /// Of the blocks that pages have.
  [[nodiscard]] std::size_t block_bytes() const { return blocks_in_use_ * block_floats() * sizeof(float); }

  /// Parameters of the Gaussians in place, `parameters` as GaussiansView::parameters but to be changed. learning_rate
  /// has layout.channels() entries.
  void step(const GaussiansView& gaussians, float* parameters, const ParameterGradient& gradient,
            const std::vector<float>& learning_rate, int threads);

  /// The next step of Gaussians from `begin` on, which lie in one page, without a gradient's values; for
  /// Rasterizer::backward_step().
  [[nodiscard]] AdamStep piece(const GaussiansView& gaussians, float* parameters, const ParameterGradient& gradient,
                               const std::vector<float>& learning_rate, std::size_t begin) const;
  /// Throws std::invalid_argument when moments, gradient and rates do not belong together.
  void check(const ParameterGradient& gradient, const std::vector<float>& learning_rate) const;

 private:
  struct Free {
    void operator()(float* memory) const { std::free(memory); }
  };
  /// [2 channels + kCounters][kRowWords]: first moments, second moments; steps as integers, LearningAge's two. Null for
  /// a page that has never trained, or rests.
  [[nodiscard]] float* block(std::size_t page) const { return pages_[page].block; }
  /// The page's, made or woken.
  float* own_block(std::size_t page);
  /// What a second moment is, so far, of what it tends to.
  [[nodiscard]] float second_bias(const float* counters, std::size_t lane) const;
  void release(std::size_t page);
  void rest(std::size_t page);
  [[nodiscard]] std::size_t channels() const { return static_cast<std::size_t>(layout_.channels()); }
  [[nodiscard]] std::size_t rows() const { return 2 * static_cast<std::size_t>(layout_.channels()) + kCounters; }
  static constexpr std::size_t kCounters = 3;
  /// Where the views stand from the piece that begins there.
  void look(const GaussiansView& gaussians, std::size_t begin, AdamStep& step) const;
  [[nodiscard]] std::size_t block_floats() const;

  struct Page {
    float* block = nullptr;
    /// Of one that rests: mean second moments [channels], then its counters [kCounters][kRowWords].
    std::vector<float> rest;
  };

  ParameterLayout layout_;
  std::size_t count_ = 0, blocks_in_use_ = 0;
  std::vector<Page> pages_;
  std::vector<std::unique_ptr<float, Free>> arenas_;
  std::vector<float*> free_blocks_;
};

}  // namespace splatbus::raster
