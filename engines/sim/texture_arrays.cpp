#include "sim/texture_arrays.h"

#include <algorithm>
#include <bit>
#include <map>
#include <tuple>

#include "sim/mipmaps.h"

namespace splatbus::sim {
namespace {

constexpr std::size_t kMostLayers = 256;  // every OpenGL has as many

GlTexture upload(const std::vector<const Image*>& layers, bool repeat, float anisotropy) {
  GlTexture texture = make_texture(GL_TEXTURE_2D_ARRAY);
  const Image& first = *layers.front();
  const auto levels = static_cast<GLsizei>(std::bit_width(std::max(first.width, first.height)));
  const auto width = static_cast<GLsizei>(first.width);
  const auto height = static_cast<GLsizei>(first.height);
  // A software driver compiles shaders to make mipmaps, which takes longer than making them here.
  const bool whole = has_whole_mipmaps(first);
  glTextureStorage3D(texture.get(), levels, GL_SRGB8_ALPHA8, width, height, static_cast<GLsizei>(layers.size()));
  GLint layer = 0;
  for (const Image* image : layers) {
    GLint level = 0;
    const auto put = [&](const Image& texels) {
      glTextureSubImage3D(texture.get(), level++, 0, 0, layer, static_cast<GLsizei>(texels.width),
                          static_cast<GLsizei>(texels.height), 1, GL_RGBA, GL_UNSIGNED_BYTE, texels.rgba.data());
    };
    put(*image);
    if (whole) std::ranges::for_each(mipmaps(*image), put);
    ++layer;
  }
  if (!whole) glGenerateTextureMipmap(texture.get());
  glTextureParameteri(texture.get(), GL_TEXTURE_MIN_FILTER, GL_LINEAR_MIPMAP_LINEAR);
  glTextureParameteri(texture.get(), GL_TEXTURE_MAG_FILTER, GL_LINEAR);
  for (const GLenum axis : {GL_TEXTURE_WRAP_S, GL_TEXTURE_WRAP_T}) {
    glTextureParameteri(texture.get(), axis, repeat ? GL_REPEAT : GL_CLAMP_TO_EDGE);
  }
  if (anisotropy > 1 && epoxy_has_gl_extension("GL_EXT_texture_filter_anisotropic")) {
    glTextureParameterf(texture.get(), GL_TEXTURE_MAX_ANISOTROPY_EXT, anisotropy);
  }
  return texture;
}

}  // namespace

TextureArrays::TextureArrays(const Scene& scene, float anisotropy) {
  const Image white{.width = 1, .height = 1, .rgba = {255, 255, 255, 255}};
  struct Growing {
    bool repeat;
    std::vector<const Image*> layers;
  };
  std::vector<Growing> growing;
  std::map<std::tuple<std::uint32_t, std::uint32_t, bool>, std::size_t> open;  // the array that takes the next layer
  for (const Material& material : scene.materials) {
    const Image& image = material.image >= 0 ? scene.images.at(static_cast<std::size_t>(material.image)) : white;
    const auto [array, added] = open.try_emplace({image.width, image.height, material.repeat}, growing.size());
    if (!added && growing[array->second].layers.size() == kMostLayers) array->second = growing.size();
    if (array->second == growing.size()) growing.push_back({material.repeat, {}});
    std::vector<const Image*>& layers = growing[array->second].layers;
    // Materials that share an image share its layer.
    const auto layer = std::ranges::find(layers, &image);
    places_.push_back({array->second, static_cast<GLuint>(layer - layers.begin())});
    if (layer == layers.end()) layers.push_back(&image);
  }
  for (const Growing& array : growing) arrays_.push_back(upload(array.layers, array.repeat, anisotropy));
}

}  // namespace splatbus::sim
