#pragma once

#include <cstddef>
#include <initializer_list>

#include "gl/objects.h"

/// What compute shaders have in common that take one step after another.
namespace splatbus::viewer::gl {

inline constexpr std::size_t kWord = sizeof(GLuint);

/// Of words that only the device reads and writes.
[[nodiscard]] inline GlBuffer make_words(std::size_t count) {
  GlBuffer buffer = make_buffer();
  glNamedBufferData(buffer.get(), static_cast<GLsizeiptr>(count * kWord), nullptr, GL_DYNAMIC_COPY);
  return buffer;
}

[[nodiscard]] inline GLuint groups_of(std::size_t count, std::size_t each) {
  return static_cast<GLuint>((count + each - 1) / each);
}

inline void bind_buffers(std::initializer_list<GLuint> buffers) {
  glBindBuffersBase(GL_SHADER_STORAGE_BUFFER, 0, static_cast<GLsizei>(buffers.size()), buffers.begin());
}

/// What the next step reads is what the last one wrote.
inline void next_step() {
  glMemoryBarrier(GL_SHADER_STORAGE_BARRIER_BIT | GL_COMMAND_BARRIER_BIT);
}

/// As many groups as the words of `buffer` at `offset` say.
inline void dispatch_indirect(GLuint buffer, std::size_t offset) {
  glBindBuffer(GL_DISPATCH_INDIRECT_BUFFER, buffer);
  glDispatchComputeIndirect(static_cast<GLintptr>(offset));
}

}  // namespace splatbus::viewer::gl
