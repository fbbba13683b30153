#pragma once

#include <cstddef>
#include <vector>

#include "gl/objects.h"
#include "sim/scene.h"

namespace splatbus::sim {

/// A scene's textures on the GPU, those of one size and edge as layers of one, so that whatever has one of them is
/// drawn at once.
class TextureArrays {
 public:
  struct Place {
    std::size_t array = 0;
    GLuint layer = 0;
  };

  TextureArrays(const Scene& scene, float anisotropy);

  /// Of a material, by its index in the scene. One without an image is plain white.
  [[nodiscard]] Place place(std::size_t material) const { return places_.at(material); }
  /// GL_TEXTURE_2D_ARRAY.
  [[nodiscard]] GLuint array(std::size_t index) const { return arrays_.at(index).get(); }

 private:
  std::vector<Place> places_;  ///< by material
  std::vector<GlTexture> arrays_;
};

}  // namespace splatbus::sim
