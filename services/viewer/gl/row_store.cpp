#include "viewer/gl/row_store.h"

#include <algorithm>
#include <utility>

#include "gl/program.h"
#include "viewer/gl/shaders.h"

namespace splatbus::viewer::gl {
namespace {

constexpr std::size_t kLeastRows = 16384;

GlBuffer sized_buffer(std::size_t bytes) {
  GlBuffer buffer = make_buffer();
  glNamedBufferData(buffer.get(), static_cast<GLsizeiptr>(bytes), nullptr, GL_DYNAMIC_DRAW);
  glClearNamedBufferData(buffer.get(), GL_R32UI, GL_RED_INTEGER, GL_UNSIGNED_INT, nullptr);
  return buffer;
}

void grow(GlBuffer& buffer, std::size_t before, std::size_t after) {
  GlBuffer grown = sized_buffer(after);
  if (before > 0) glCopyNamedBufferSubData(buffer.get(), grown.get(), 0, 0, static_cast<GLsizeiptr>(before));
  buffer = std::move(grown);
}

}  // namespace

RowStore::RowStore()
    : scatter_(make_compute_program(kScatterText)),
      harmonics_(sized_buffer(sizeof(std::uint32_t))),
      changed_rows_(make_buffer()),
      changed_(make_buffer()),
      changed_fades_(make_buffer()) {
  reserve(1);
}

void RowStore::reserve(std::size_t rows) {
  if (rows <= capacity_) return;
  const std::size_t before = std::exchange(capacity_, std::max({rows, 2 * capacity_, kLeastRows}));
  grow(records_, before * sizeof(stream::GpuRecord), capacity_ * sizeof(stream::GpuRecord));
  grow(fades_, before * sizeof(float), capacity_ * sizeof(float));
}

void RowStore::bind() const {
  glBindBufferBase(GL_SHADER_STORAGE_BUFFER, kRecordBinding, records_.get());
  glBindBufferBase(GL_SHADER_STORAGE_BUFFER, kFadeBinding, fades_.get());
  glBindBufferBase(GL_SHADER_STORAGE_BUFFER, kHarmonicBinding, harmonics_.get());
}

void RowStore::apply(const RowUpdate& update) {
  if (update.rows.empty()) return;
  reserve(std::size_t{*std::max_element(update.rows.begin(), update.rows.end())} + 1);
  scatter(update.rows, std::as_bytes(std::span(update.records)), update.fades);
}

void RowStore::recolor(const ColorUpdate& update) {
  if (!update.rows.empty()) scatter(update.rows, std::as_bytes(std::span(update.colors)), {});
}

void RowStore::scatter(std::span<const std::uint32_t> rows, std::span<const std::byte> contents,
                       std::span<const float> fades) {
  const auto upload = [&](const GlBuffer& buffer, unsigned binding, std::span<const std::byte> bytes) {
    glNamedBufferData(buffer.get(), static_cast<GLsizeiptr>(std::max<std::size_t>(bytes.size(), sizeof(float))),
                      nullptr, GL_STREAM_DRAW);
    glNamedBufferSubData(buffer.get(), 0, static_cast<GLsizeiptr>(bytes.size()), bytes.data());
    glBindBufferBase(GL_SHADER_STORAGE_BUFFER, binding, buffer.get());
    uploaded_.bytes += bytes.size();
  };
  upload(changed_rows_, kChangedRowBinding, std::as_bytes(rows));
  upload(changed_, kChangedRecordBinding, contents);
  upload(changed_fades_, kChangedFadeBinding, std::as_bytes(fades));
  bind();
  glUseProgram(scatter_.get());
  glUniform1ui(kChanged, static_cast<GLuint>(rows.size()));
  glUniform1i(kColorOnly, fades.empty() ? GL_TRUE : GL_FALSE);
  glDispatchCompute(static_cast<GLuint>((rows.size() + kScatterGroup - 1) / kScatterGroup), 1, 1);
  glMemoryBarrier(GL_SHADER_STORAGE_BARRIER_BIT | GL_BUFFER_UPDATE_BARRIER_BIT);
  uploaded_.rows += rows.size();
}

void RowStore::set_harmonics(const Harmonics& harmonics) {
  harmonic_words_ = static_cast<int>(harmonics.words);
  const std::size_t bytes = harmonics.values.size() * sizeof(std::uint32_t);
  glNamedBufferData(harmonics_.get(), static_cast<GLsizeiptr>(std::max(bytes, sizeof(std::uint32_t))), nullptr,
                    GL_STATIC_DRAW);
  glNamedBufferSubData(harmonics_.get(), 0, static_cast<GLsizeiptr>(bytes), harmonics.values.data());
  uploaded_.bytes += bytes;
}

void RowStore::clear() {
  for (const GlBuffer* buffer : {&records_, &fades_}) {
    glClearNamedBufferData(buffer->get(), GL_R32UI, GL_RED_INTEGER, GL_UNSIGNED_INT, nullptr);
  }
}

}  // namespace splatbus::viewer::gl
