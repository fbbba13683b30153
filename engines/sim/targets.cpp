#include "sim/targets.h"

#include <fmt/format.h>

#include <algorithm>
#include <stdexcept>

namespace splatbus::sim {
namespace {

constexpr std::size_t kCacheBytes = std::size_t{1} << 30;
constexpr std::size_t kCacheSizes = 8;

GlTexture texture_2d(GLenum format, GLsizei width, GLsizei height) {
  GlTexture texture = make_texture(GL_TEXTURE_2D);
  glTextureStorage2D(texture.get(), 1, format, width, height);
  return texture;
}

void require_complete(const GlFramebuffer& framebuffer, const Targets& targets) {
  const GLenum status = glCheckNamedFramebufferStatus(framebuffer.get(), GL_FRAMEBUFFER);
  if (status == GL_FRAMEBUFFER_COMPLETE) return;
  throw std::runtime_error(
      fmt::format("no framebuffer for pictures of {} x {} (status {:#x})", targets.width, targets.height, status));
}

}  // namespace

std::size_t Targets::bytes(int supersample, int samples) const {
  const auto pixels = static_cast<std::size_t>(width) * height;
  std::size_t a_pixel = 0;
  if (shade) a_pixel += static_cast<std::size_t>(supersample * supersample * samples) * (8 + 8 + 4) + 4 + 4;
  if (geometry) a_pixel += 16 + 16 + 4 + 4 + 4;
  return pixels * a_pixel;
}

Targets& TargetCache::get(std::uint32_t width, std::uint32_t height, bool shade, bool geometry) {
  auto found = std::ranges::find_if(targets_, [&](const auto& t) { return t->width == width && t->height == height; });
  if (found == targets_.end()) {
    auto made = std::make_unique<Targets>();
    made->width = width;
    made->height = height;
    targets_.insert(targets_.begin(), std::move(made));
  } else {
    std::rotate(targets_.begin(), found, found + 1);
  }
  Targets& targets = *targets_.front();
  if (shade && !targets.shade) add_shade(targets);
  if (geometry && !targets.geometry) add_geometry(targets);

  const auto total = [&] {
    std::size_t sum = 0;
    for (const auto& t : targets_) sum += t->bytes(supersample_, samples_);
    return sum;
  };
  while (targets_.size() > 1 && (targets_.size() > kCacheSizes || total() > kCacheBytes)) targets_.pop_back();
  return targets;
}

void TargetCache::add_shade(Targets& targets) const {
  const auto width = static_cast<GLsizei>(targets.width);
  const auto height = static_cast<GLsizei>(targets.height);
  const auto samples_2d = [&](GLenum format) {
    GlTexture texture = make_texture(GL_TEXTURE_2D_MULTISAMPLE);
    glTextureStorage2DMultisample(texture.get(), samples_, format, width * supersample_, height * supersample_,
                                  GL_TRUE);
    return texture;
  };
  targets.lit_samples = samples_2d(GL_RGBA16F);
  targets.albedo_samples = samples_2d(GL_RGBA16F);
  targets.shade_depth = samples_2d(GL_DEPTH_COMPONENT32F);
  GlFramebuffer shade = make_framebuffer();
  glNamedFramebufferTexture(shade.get(), GL_COLOR_ATTACHMENT0, targets.lit_samples.get(), 0);
  glNamedFramebufferTexture(shade.get(), GL_COLOR_ATTACHMENT1, targets.albedo_samples.get(), 0);
  glNamedFramebufferTexture(shade.get(), GL_DEPTH_ATTACHMENT, targets.shade_depth.get(), 0);
  require_complete(shade, targets);

  targets.color = texture_2d(GL_RGBA8, width, height);
  targets.albedo = texture_2d(GL_RGBA8, width, height);
  GlFramebuffer resolve = make_framebuffer();
  glNamedFramebufferTexture(resolve.get(), GL_COLOR_ATTACHMENT0, targets.color.get(), 0);
  glNamedFramebufferTexture(resolve.get(), GL_COLOR_ATTACHMENT1, targets.albedo.get(), 0);
  require_complete(resolve, targets);
  targets.shade = std::move(shade);
  targets.resolve = std::move(resolve);
}

void TargetCache::add_geometry(Targets& targets) {
  const auto width = static_cast<GLsizei>(targets.width);
  const auto height = static_cast<GLsizei>(targets.height);
  targets.position = texture_2d(GL_RGBA32F, width, height);
  targets.normal = texture_2d(GL_RGBA32F, width, height);
  targets.view_depth = texture_2d(GL_R32F, width, height);
  targets.object_id = texture_2d(GL_R32UI, width, height);
  targets.geometry_depth = texture_2d(GL_DEPTH_COMPONENT32F, width, height);
  GlFramebuffer geometry = make_framebuffer();
  glNamedFramebufferTexture(geometry.get(), GL_COLOR_ATTACHMENT0, targets.position.get(), 0);
  glNamedFramebufferTexture(geometry.get(), GL_COLOR_ATTACHMENT1, targets.normal.get(), 0);
  glNamedFramebufferTexture(geometry.get(), GL_COLOR_ATTACHMENT2, targets.view_depth.get(), 0);
  glNamedFramebufferTexture(geometry.get(), GL_COLOR_ATTACHMENT3, targets.object_id.get(), 0);
  glNamedFramebufferTexture(geometry.get(), GL_DEPTH_ATTACHMENT, targets.geometry_depth.get(), 0);
  require_complete(geometry, targets);
  targets.geometry = std::move(geometry);
}

}  // namespace splatbus::sim
