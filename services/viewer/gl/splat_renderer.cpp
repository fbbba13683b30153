#include "viewer/gl/splat_renderer.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <stdexcept>
#include <utility>

#include "gl/context.h"
#include "gl/program.h"
#include "viewer/gl/shaders.h"
#include "viewer/scaled.h"

namespace splatbus::viewer::gl {
namespace {

float srgb(float linear) {
  return linear <= 0.0031308F ? 12.92F * linear : 1.055F * std::pow(linear, 1 / 2.4F) - 0.055F;
}

GlTexture sized_texture(GLenum format, std::uint32_t width, std::uint32_t height) {
  GlTexture texture = make_texture(GL_TEXTURE_2D);
  glTextureStorage2D(texture.get(), 1, format, static_cast<GLsizei>(width), static_cast<GLsizei>(height));
  glTextureParameteri(texture.get(), GL_TEXTURE_MIN_FILTER, GL_NEAREST);
  glTextureParameteri(texture.get(), GL_TEXTURE_MAG_FILTER, GL_NEAREST);
  glTextureParameteri(texture.get(), GL_TEXTURE_WRAP_S, GL_CLAMP_TO_EDGE);
  glTextureParameteri(texture.get(), GL_TEXTURE_WRAP_T, GL_CLAMP_TO_EDGE);
  return texture;
}

GlFramebuffer framebuffer_of(const GlTexture& texture) {
  GlFramebuffer framebuffer = make_framebuffer();
  glNamedFramebufferTexture(framebuffer.get(), GL_COLOR_ATTACHMENT0, texture.get(), 0);
  if (glCheckNamedFramebufferStatus(framebuffer.get(), GL_FRAMEBUFFER) != GL_FRAMEBUFFER_COMPLETE) {
    require_context();
    throw std::runtime_error("the graphics driver cannot draw into 16-bit floats");
  }
  return framebuffer;
}

}  // namespace

SplatRenderer::SplatRenderer(Draw draw)
    : choice_(draw),
      splats_(make_program(kSplatVertexText, kSplatFragmentText)),
      resolve_(make_program(kResolveVertexText, kResolveFragmentText)),
      quads_(make_vertex_array()),
      nothing_(make_vertex_array()),
      indices_(make_buffer()) {
  std::vector<std::uint16_t> indices;
  for (unsigned quad = 0; quad < kBatch; ++quad) {
    for (const unsigned corner : {0, 1, 2, 2, 1, 3}) indices.push_back(static_cast<std::uint16_t>(4 * quad + corner));
  }
  glNamedBufferData(indices_.get(), static_cast<GLsizeiptr>(indices.size() * sizeof(indices[0])), indices.data(),
                    GL_STATIC_DRAW);
  glVertexArrayElementBuffer(quads_.get(), indices_.get());
}

void SplatRenderer::make_target(std::uint32_t width, std::uint32_t height) {
  if (width == width_ && height == height_) return;
  target_ = sized_texture(GL_RGBA16F, width, height);
  framebuffer_ = framebuffer_of(target_);
  width_ = width;
  height_ = height;
}

void SplatRenderer::set_timed(bool timed) {
  timed_ = timed;
  times_.clear();
}

std::vector<StepTimes> SplatRenderer::take_times() {
  look_back();
  return std::exchange(times_, {});
}

const Drawn& SplatRenderer::drawn() {
  glFinish();
  look_back();
  return drawn_;
}

void SplatRenderer::look_back() {
  std::vector<StepTimes> done;
  while (const auto times = timer_.take()) done.push_back(*times);
  // A picture's list was known before it was done: where there was no room, its time is not that of tiles.
  while (const auto listed = tiles_ ? tiles_->take() : std::nullopt) {
    ++(listed->fitted ? drawn_.by_tiles : drawn_.by_quads);
    if (!listed->fitted) ++drawn_.without_room;
    drawn_.pairs = listed->pairs;
    if (listed->grown) choice_.try_again();
  }
  for (const StepTimes& times : done) {
    if (times.trial != 0) choice_.took(times.trial, times.way, times.all_ms);
    if (timed_) times_.push_back(times);
  }
}

void SplatRenderer::draw_splats(const Frame& frame) {
  const Camera& camera = frame.camera;
  make_target(camera.width, camera.height);
  const Way way = choice_.next(rows_.used());
  if (timed_ || choice_.trial() != 0) timer_.begin(way, choice_.trial());
  projection_.run(rows_, frame, timer_);
  if (way == Way::Tiles) {
    if (!tiles_) tiles_.emplace();
    tiles_->list(projection_, rows_.capacity(), camera.width, camera.height, timer_);
    tiles_->blend(projection_, target_.get());
  } else {
    constexpr std::array<float, 4> kNothing{};
    glClearNamedFramebufferfv(framebuffer_.get(), GL_COLOR, 0, kNothing.data());
    ++drawn_.by_quads;
    if (tiles_ && choice_.trial() == 0) tiles_->release();
  }
  draw_quads(camera);  // none, where tiles had room
  timer_.mark(FrameTimer::kDrawn);
}

void SplatRenderer::draw_quads(const Camera& camera) {
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.get());
  glViewport(0, 0, static_cast<GLsizei>(camera.width), static_cast<GLsizei>(camera.height));
  projection_.bind();
  glUseProgram(splats_.get());
  glUniform2f(kSize, static_cast<float>(camera.width), static_cast<float>(camera.height));
  glDisable(GL_DEPTH_TEST);
  glEnable(GL_BLEND);
  glBlendFunc(GL_ONE, GL_ONE_MINUS_SRC_ALPHA);
  glBindVertexArray(quads_.get());
  glBindBuffer(GL_DRAW_INDIRECT_BUFFER, projection_.seen());
  // NOLINTNEXTLINE(performance-no-int-to-ptr): OpenGL's offset into the bound buffer
  glDrawElementsIndirect(GL_TRIANGLES, GL_UNSIGNED_SHORT, reinterpret_cast<const void*>(offsetof(Seen, draw)));
}

void SplatRenderer::draw(const Frame& frame, GLuint framebuffer) {
  require_context();
  look_back();
  if (frame.resolution == 1) {
    draw_splats(frame);
  } else {
    Frame coarse = frame;
    coarse.camera = scaled(frame.camera, frame.resolution);
    draw_splats(coarse);
  }
  resolve(frame, framebuffer);
  timer_.end();
}

void SplatRenderer::resolve(const Frame& frame, GLuint framebuffer) {
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer);
  glViewport(0, 0, static_cast<GLsizei>(frame.camera.width), static_cast<GLsizei>(frame.camera.height));
  glDisable(GL_BLEND);
  glUseProgram(resolve_.get());
  glTextureParameteri(target_.get(), GL_TEXTURE_MAG_FILTER, frame.resolution == 1 ? GL_NEAREST : GL_LINEAR);
  glBindTextureUnit(0, target_.get());
  glm::vec3 background = frame.background;
  if (frame.display_space) background = {srgb(background.x), srgb(background.y), srgb(background.z)};
  glUniform3f(kBackground, background.x, background.y, background.z);
  glUniform1i(kDisplaySpace, frame.display_space ? GL_TRUE : GL_FALSE);
  glBindVertexArray(nothing_.get());
  glDrawArrays(GL_TRIANGLES, 0, 3);
}

Picture SplatRenderer::capture(const Frame& frame) {
  const std::uint32_t width = frame.camera.width, height = frame.camera.height;
  const GlTexture texture = sized_texture(GL_RGBA8, width, height);
  const GlFramebuffer framebuffer = framebuffer_of(texture);
  draw(frame, framebuffer.get());
  Picture out{.width = static_cast<int>(width), .height = static_cast<int>(height), .rgba = {}};
  const std::size_t stride = std::size_t{4} * width;
  std::vector<std::uint8_t> bottom_up(stride * height);
  glPixelStorei(GL_PACK_ALIGNMENT, 1);
  glReadPixels(0, 0, out.width, out.height, GL_RGBA, GL_UNSIGNED_BYTE, bottom_up.data());
  require_context();
  out.rgba.resize(bottom_up.size());
  for (std::size_t y = 0; y < height; ++y) {
    const auto row = bottom_up.begin() + static_cast<std::ptrdiff_t>((height - 1 - y) * stride);
    std::copy_n(row, stride, out.rgba.begin() + static_cast<std::ptrdiff_t>(y * stride));
  }
  return out;
}

}  // namespace splatbus::viewer::gl
