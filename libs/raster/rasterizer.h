#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "gaussians/model.h"

namespace splatbus::raster {

/// A planar float image in host memory: plane c at data + c * width * height, row 0 on top.
struct Image {
  std::uint32_t width = 0, height = 0, channels = 0;
  std::vector<float> data;

  Image() = default;
  Image(std::uint32_t w, std::uint32_t h, std::uint32_t c)
      : width(w), height(h), channels(c), data(std::size_t{w} * h * c) {}
  [[nodiscard]] float* plane(std::uint32_t c) { return data.data() + std::size_t{c} * width * height; }
  [[nodiscard]] const float* plane(std::uint32_t c) const { return data.data() + std::size_t{c} * width * height; }
};

struct RenderOptions {
  bool antialias =
      true;  ///< opacity times sqrt(det cov / det(cov + blur)) (Yu et al. 2024, Mip-Splatting 2D filter, as gsplat)
  float blur_px2 = 0.3F;  ///< added to the diagonal of the projected covariance, pixels squared
  bool albedo = false;    ///< also render the albedo, unlit (Transfer only)
  bool depth = false;     ///< also render depth: sum of weight * z, not normalised, metres
  /// Pages that these hide by their bounds are left out, but for the far field's; in memory of the device that draws.
  FarthestSurfaces hidden_behind = {};
};

/// Planes of a render: colour (Transfer: linear over background; Radiance: display space over background converted to
/// display space), alpha, and what the options ask for. Albedo is over black.
struct Render {
  Image color;   // 3
  Image alpha;   // 1
  Image albedo;  // 3 or empty
  Image depth;   // 1 or empty
};

/// Gradients of the loss with respect to the planes of a Render; empty images count as zero.
struct RenderGradient {
  Image color;
  Image alpha;
  Image albedo;
  Image depth;
  /// [height][width], as the engine has it; null: unknown. A Gaussian of the far field whose middle is not where the
  /// picture shows sky gets no gradient: what the model lets through elsewhere is no fault of the sky's.
  const float* surface_depth = nullptr;
};

/// What a picture shows of a page.
struct PageLook {
  std::uint32_t page = 0;
  std::uint32_t pairs = 0;  ///< Gaussians of it in tiles of the picture, up to where nothing shows any more
  double error = 0;         ///< of those tiles, each as often as it has such a Gaussian: the mean
};

/// Gradients of the parameters, channel by channel in the order of indices: [channels][stride]. Frozen Gaussians, and
/// those of frozen ranges, get none (their entries are zero). `touched[i]` is non-zero where Gaussian i was projected
/// into a view since clear(); of what is frozen it may stay 0.
struct ParameterGradient {
  ParameterLayout layout;
  int active_channels =
      0;  ///< backward and Adam work on channels below this only; 0: all. 14 leaves out the residual transfer
  std::size_t count = 0, stride = 0;
  std::vector<float> values;
  std::vector<std::uint8_t> touched;
  std::vector<float>
      mean2d_norm;  ///< [count] sum over views of |dL/d(projected mean)| in NDC units, for clone and split
  std::vector<float> contribution;  ///< [count] largest blending weight a Gaussian had in any pixel since clear()

  std::vector<IndexRange> written;  ///< by a Rasterizer since clear(): of all else the statistics are 0 already

  /// Sizes, and zeroes what counts: the columns of active channels. At most `threads` do it, 0: all cores.
  void clear(const GaussiansView& gaussians, int threads = 0);
  void clear_statistics(const GaussiansView& gaussians);  ///< the same, but `values` is left empty
};

class Adam;

/// How long a part of the last forward() or backward() took.
struct StageTime {
  const char* name;
  double milliseconds;
};

/// Differentiable splatting. Front to back, tiles, alpha at most 0.999, contributions under 1/255 skipped, a pixel ends
/// when its transmittance falls under 1e-4; projection by the local affine approximation (Zwicker et al. 2001) with
/// 3DGS's clamp of the tangent to 1.3 times the field of view; gradients by hand, exact for this forward (Kerbl et al.
/// 2023, section 4 and appendix).
///
/// A Rasterizer owns scratch memory and a thread pool: one forward-backward pair at a time, not thread-safe.
class Rasterizer {
 public:
  virtual ~Rasterizer() = default;

  /// Reads parameters, normal, visibility (Transfer), object_id.
  virtual void forward(const GaussiansView& gaussians, const Camera& camera, const SceneState& scene,
                       const RenderOptions& options, Render& out) = 0;

  /// Adds to `out` the gradient of the last forward(), whose arguments must not have changed. `gaussians.flags` and
  /// IndexRange::frozen say who is frozen.
  virtual void backward(const RenderGradient& gradient, ParameterGradient& out) = 0;

  /// backward() and Adam::step() in one pass for a batch of one view: gradients stay in the cache, `statistics`
  /// (clear_statistics() is enough) gets all but values. `parameters` are those of the forward pass, to be changed.
  virtual void backward_step(const RenderGradient& gradient, const std::vector<float>& learning_rate, Adam& adam,
                             float* parameters, ParameterGradient& statistics) = 0;

  /// Forward only, keeping nothing for a backward pass; faster.
  virtual void render(const GaussiansView& gaussians, const Camera& camera, const SceneState& scene,
                      const RenderOptions& options, Render& out) = 0;

  /// What the picture of the last forward() shows of each page, ascending; of page 0 without pages. `error`: one plane,
  /// of its size; pixels below 0, or that are no number, do not count. Nothing where that is not known.
  virtual void look_at_pages(const Image& /*error*/, std::vector<PageLook>& looks) { looks.clear(); }

  /// Of the last forward(): the opacity of what is nearer to the camera than `distance_m`, at kUnmodelledSamples
  /// pixels of each square of kUnmodelledSide (raster/unmodelled.h), row after row; 0 where they lie outside. Above
  /// 0.99 it may be less than it would come to. Nothing where that is not known, or where the model has no far field.
  virtual void opacity_within(float /*distance_m*/, std::vector<float>& opacity) { opacity.clear(); }

  /// Stages of the last forward() or render(), then of the last backward().
  [[nodiscard]] virtual std::vector<StageTime> stage_times() const { return {}; }
};

/// threads 0: all cores.
[[nodiscard]] std::unique_ptr<Rasterizer> make_cpu_rasterizer(int threads = 0);

}  // namespace splatbus::raster
