#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "gaussians/model.h"
#include "stream/quantized.h"

namespace splatbus::bench {

/// A model, and pictures to judge by.
struct CodecScene {
  std::string name;
  GaussiansBuffer model;
  std::vector<std::size_t> page_ends;  ///< Gaussians [end before, end) are a page
  std::vector<Camera> cameras;         ///< 512 x 512
  SceneState scene;
};

/// A PLY, cut into pages of so many along a Morton curve and to SH `degree` (-1: as it is), or a world folder with its
/// own pages. Cameras stand around it and within it. Throws std::runtime_error, naming the path.
[[nodiscard]] CodecScene load_codec_scene(const std::string& path, int degree, std::size_t page_gaussians = kPageLanes);

/// A layout with steps of one's own: those of `steps` that are above 0, in the order of the layout's attributes.
[[nodiscard]] stream::StreamLayout layout_with(const stream::StreamLayout& layout, const std::vector<float>& steps);

/// Pictures of a model, in display space.
class Pictures {
 public:
  /// Of the model as it is.
  explicit Pictures(const CodecScene& scene);
  /// Peak signal to noise ratio, peak 1, all cameras' pixels together, of what a viewer shows of `gaussians`.
  [[nodiscard]] double psnr_db(const stream::QuantizedGaussians& gaussians, const stream::StreamLayout& layout) const;

 private:
  [[nodiscard]] std::vector<float> draw(const GaussiansView& gaussians) const;
  const CodecScene& scene_;
  std::vector<float> truth_;
};

}  // namespace splatbus::bench
