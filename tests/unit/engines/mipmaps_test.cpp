// The levels of a texture, beside those that OpenGL makes of it.
#include "sim/mipmaps.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <random>

#include "gl/objects.h"
#include "render_scenes.h"

namespace splatbus::sim {
namespace {

Image noise_image(std::uint32_t width, std::uint32_t height) {
  Image image{.width = width, .height = height, .rgba = std::vector<std::uint8_t>(std::size_t{4} * width * height)};
  std::mt19937 random(width + height);
  for (std::uint8_t& byte : image.rgba) byte = static_cast<std::uint8_t>(random());
  return image;
}

TEST(Mipmaps, AreThoseOfOpenGlWithinAByteOrTwo) {
  const auto context = shared_context();
  for (const auto& [width, height] : {std::pair{128U, 128U}, {64U, 16U}, {4U, 32U}, {1U, 1U}}) {
    SCOPED_TRACE(testing::Message() << width << " x " << height);
    const Image image = noise_image(width, height);
    ASSERT_TRUE(has_whole_mipmaps(image));
    const std::vector<Image> levels = mipmaps(image);
    const GlTexture texture = make_texture(GL_TEXTURE_2D);
    glTextureStorage2D(texture.get(), static_cast<GLsizei>(levels.size() + 1), GL_SRGB8_ALPHA8,
                       static_cast<GLsizei>(width), static_cast<GLsizei>(height));
    glTextureSubImage2D(texture.get(), 0, 0, 0, static_cast<GLsizei>(width), static_cast<GLsizei>(height), GL_RGBA,
                        GL_UNSIGNED_BYTE, image.rgba.data());
    glGenerateTextureMipmap(texture.get());
    // One more of these would be an error of OpenGL, one less a texture without its last level.
    ASSERT_EQ(glGetError(), static_cast<GLenum>(GL_NO_ERROR));
    EXPECT_TRUE(levels.empty() || levels.back().rgba.size() == 4);
    for (std::size_t level = 0; level < levels.size(); ++level) {
      std::vector<std::uint8_t> expected(levels[level].rgba.size());
      glGetTextureImage(texture.get(), static_cast<GLint>(level + 1), GL_RGBA, GL_UNSIGNED_BYTE,
                        static_cast<GLsizei>(expected.size()), expected.data());
      ASSERT_EQ(glGetError(), static_cast<GLenum>(GL_NO_ERROR)) << "level " << level + 1;
      int worst = 0;
      for (std::size_t i = 0; i < expected.size(); ++i) {
        worst = std::max(worst, std::abs(int{expected[i]} - int{levels[level].rgba[i]}));
      }
      // Each level is made of the last one's bytes, here and there.
      EXPECT_LE(worst, static_cast<int>(2 + level / 2)) << "level " << level + 1;
    }
  }
}

TEST(Mipmaps, OfOddSidesAreLeftToOpenGl) {
  EXPECT_FALSE(has_whole_mipmaps(noise_image(6, 8)));
  EXPECT_FALSE(has_whole_mipmaps(noise_image(8, 6)));
}

}  // namespace
}  // namespace splatbus::sim
