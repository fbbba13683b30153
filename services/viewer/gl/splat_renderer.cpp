#include "viewer/gl/splat_renderer.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>

#include "gl/program.h"
#include "viewer/gl/shaders.h"

namespace splatbus::viewer::gl {
namespace {

/// view_from_world, row-major [3][4].
std::array<double, 12> view_of(const Camera& camera) {
  const Rigid view = inverse(camera.world_from_camera);
  const glm::dmat3 rotation = glm::mat3_cast(glm::dquat(view.rotation));
  std::array<double, 12> out{};
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) out[static_cast<std::size_t>(4 * row + column)] = rotation[column][row];
    out[static_cast<std::size_t>(4 * row + 3)] = view.translation[row];
  }
  return out;
}

/// 0.3 of the half field of view beyond the picture's sides: left, right, top, bottom, as tangents.
glm::vec4 tangent_limits(const Camera& camera) {
  const auto width = static_cast<float>(camera.width), height = static_cast<float>(camera.height);
  const float x = 0.15F * width / camera.fx, y = 0.15F * height / camera.fy;
  return {-camera.cx / camera.fx - x, (width - camera.cx) / camera.fx + x, -camera.cy / camera.fy - y,
          (height - camera.cy) / camera.fy + y};
}

float srgb(float linear) {
  return linear <= 0.0031308F ? 12.92F * linear : 1.055F * std::pow(linear, 1 / 2.4F) - 0.055F;
}

GlTexture sized_texture(GLenum format, std::uint32_t width, std::uint32_t height) {
  GlTexture texture = make_texture(GL_TEXTURE_2D);
  glTextureStorage2D(texture.get(), 1, format, static_cast<GLsizei>(width), static_cast<GLsizei>(height));
  glTextureParameteri(texture.get(), GL_TEXTURE_MIN_FILTER, GL_NEAREST);
  glTextureParameteri(texture.get(), GL_TEXTURE_MAG_FILTER, GL_NEAREST);
  return texture;
}

GlFramebuffer framebuffer_of(const GlTexture& texture) {
  GlFramebuffer framebuffer = make_framebuffer();
  glNamedFramebufferTexture(framebuffer.get(), GL_COLOR_ATTACHMENT0, texture.get(), 0);
  if (glCheckNamedFramebufferStatus(framebuffer.get(), GL_FRAMEBUFFER) != GL_FRAMEBUFFER_COMPLETE) {
    throw std::runtime_error("the graphics driver cannot draw into 16-bit floats");
  }
  return framebuffer;
}

void require_context() {
  if (epoxy_has_gl_extension("GL_KHR_robustness") && glGetGraphicsResetStatus() != GL_NO_ERROR) {
    throw std::runtime_error("the OpenGL context was lost: the graphics device was reset");
  }
}

}  // namespace

SplatRenderer::SplatRenderer()
    : splats_(make_program(kSplatVertexText, kSplatFragmentText)),
      resolve_(make_program(kResolveVertexText, kResolveFragmentText)),
      quads_(make_vertex_array()),
      nothing_(make_vertex_array()),
      indices_(make_buffer()),
      order_(make_buffer()),
      objects_(make_buffer()) {
  std::vector<std::uint16_t> indices;
  for (int quad = 0; quad < kBatch; ++quad) {
    for (const int corner : {0, 1, 2, 2, 1, 3}) indices.push_back(static_cast<std::uint16_t>(4 * quad + corner));
  }
  glNamedBufferData(indices_.get(), static_cast<GLsizeiptr>(indices.size() * sizeof(indices[0])), indices.data(),
                    GL_STATIC_DRAW);
  glVertexArrayElementBuffer(quads_.get(), indices_.get());
}

void SplatRenderer::set_order(std::span<const std::uint32_t> order) {
  count_ = order.size();
  if (count_ > order_capacity_) order_capacity_ = std::max(count_, 2 * order_capacity_);
  const auto bytes = static_cast<GLsizeiptr>(std::max<std::size_t>(order_capacity_, 1) * sizeof(order[0]));
  glNamedBufferData(order_.get(), bytes, nullptr, GL_STREAM_DRAW);
  glNamedBufferSubData(order_.get(), 0, static_cast<GLsizeiptr>(order.size_bytes()), order.data());
}

void SplatRenderer::upload_objects(const Frame& frame) {
  const std::array<double, 12> view = view_of(frame.camera);
  camera_from_objects_.resize(12 * std::max<std::size_t>(frame.transforms.size(), 1));
  for (std::size_t object = 0; object < frame.transforms.size(); ++object) {
    const Transform& transform = frame.transforms[object];
    const bool fixed = frame.far_field == 0 || object != frame.far_field;
    for (std::size_t row = 0; row < 3; ++row) {
      for (std::size_t column = 0; column < 4; ++column) {
        double sum = column == 3 && fixed ? view[4 * row + 3] : 0;
        for (std::size_t k = 0; k < 3; ++k) sum += view[4 * row + k] * double{transform[4 * k + column]};
        camera_from_objects_[12 * object + 4 * row + column] = static_cast<float>(sum);
      }
    }
  }
  glNamedBufferData(objects_.get(), static_cast<GLsizeiptr>(camera_from_objects_.size() * sizeof(float)),
                    camera_from_objects_.data(), GL_STREAM_DRAW);
}

void SplatRenderer::make_target(std::uint32_t width, std::uint32_t height) {
  if (width == width_ && height == height_) return;
  target_ = sized_texture(GL_RGBA16F, width, height);
  framebuffer_ = framebuffer_of(target_);
  width_ = width;
  height_ = height;
}

void SplatRenderer::draw_splats(const Frame& frame) {
  const Camera& camera = frame.camera;
  make_target(camera.width, camera.height);
  upload_objects(frame);
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.get());
  glViewport(0, 0, static_cast<GLsizei>(camera.width), static_cast<GLsizei>(camera.height));
  constexpr std::array<float, 4> kNothing{};
  glClearNamedFramebufferfv(framebuffer_.get(), GL_COLOR, 0, kNothing.data());
  if (count_ == 0) return;
  rows_.bind();
  glBindBufferBase(GL_SHADER_STORAGE_BUFFER, kOrderBinding, order_.get());
  glBindBufferBase(GL_SHADER_STORAGE_BUFFER, kObjectBinding, objects_.get());
  glUseProgram(splats_.get());
  glUniform1i(kCount, static_cast<GLint>(count_));
  glUniform4f(kPinhole, camera.fx, camera.fy, camera.cx, camera.cy);
  glUniform2f(kSize, static_cast<float>(camera.width), static_cast<float>(camera.height));
  const glm::vec4 limits = tangent_limits(camera);
  glUniform4f(kTangents, limits.x, limits.y, limits.z, limits.w);
  glUniform1f(kTime, frame.time_s);
  glUniform1i(kAntialias, frame.antialias ? GL_TRUE : GL_FALSE);
  glUniform1i(kHarmonicWords, rows_.harmonic_words());
  glUniform1f(kNear, camera.near_m);
  glDisable(GL_DEPTH_TEST);
  glEnable(GL_BLEND);
  glBlendFunc(GL_ONE, GL_ONE_MINUS_SRC_ALPHA);
  glBindVertexArray(quads_.get());
  glDrawElementsInstanced(GL_TRIANGLES, 6 * kBatch, GL_UNSIGNED_SHORT, nullptr,
                          static_cast<GLsizei>((count_ + kBatch - 1) / kBatch));
}

void SplatRenderer::draw(const Frame& frame, GLuint framebuffer) {
  require_context();
  draw_splats(frame);
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer);
  glViewport(0, 0, static_cast<GLsizei>(frame.camera.width), static_cast<GLsizei>(frame.camera.height));
  glDisable(GL_BLEND);
  glUseProgram(resolve_.get());
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
