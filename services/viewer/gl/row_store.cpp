#include "viewer/gl/row_store.h"

#include <algorithm>
#include <array>
#include <utility>

#include "gl/program.h"
#include "viewer/gl/shaders.h"

namespace splatbus::viewer::gl {
namespace {

constexpr std::size_t kLeastRows = 16384;
constexpr std::size_t kRecordWords = sizeof(stream::GpuRecord) / sizeof(std::uint32_t);
constexpr std::size_t kColorWord = kRecordWords - 1;
constexpr std::size_t kMostGroups = 65535;  // of a dispatch, along an axis

GlBuffer zeroed_buffer(std::size_t bytes) {
  GlBuffer buffer = make_buffer();
  glNamedBufferData(buffer.get(), static_cast<GLsizeiptr>(bytes), nullptr, GL_DYNAMIC_DRAW);
  glClearNamedBufferData(buffer.get(), GL_R32UI, GL_RED_INTEGER, GL_UNSIGNED_INT, nullptr);
  return buffer;
}

void grow(GlBuffer& buffer, std::size_t before, std::size_t after) {
  GlBuffer grown = zeroed_buffer(after);
  if (before > 0) glCopyNamedBufferSubData(buffer.get(), grown.get(), 0, 0, static_cast<GLsizeiptr>(before));
  buffer = std::move(grown);
}

void upload(const GlBuffer& buffer, std::span<const std::byte> bytes) {
  glNamedBufferData(buffer.get(), static_cast<GLsizeiptr>(bytes.size()), bytes.data(), GL_STREAM_DRAW);
}

}  // namespace

RowStore::RowStore()
    : scatter_(make_compute_program(kScatterText)),
      keep_(make_compute_program(kKeepText)),
      harmonics_(zeroed_buffer(sizeof(std::uint32_t))),
      changed_rows_(make_buffer()),
      changed_(make_buffer()) {
  reserve(1);
}

void RowStore::reserve(std::size_t rows) {
  if (rows <= capacity_) return;
  const std::size_t before = std::exchange(capacity_, std::max({rows, 2 * capacity_, kLeastRows}));
  grow(records_, before * sizeof(stream::GpuRecord), capacity_ * sizeof(stream::GpuRecord));
  grow(fades_, before * sizeof(float), capacity_ * sizeof(float));
  grow(kept_, before * sizeof(std::uint32_t), capacity_ * sizeof(std::uint32_t));
  const std::size_t row_bytes = harmonic_words_ * sizeof(std::uint32_t);
  if (row_bytes > 0) grow(harmonics_, before * row_bytes, capacity_ * row_bytes);
}

void RowStore::set_harmonic_words(std::size_t words) {
  if (std::exchange(harmonic_words_, words) == words) return;
  harmonics_ = zeroed_buffer(std::max<std::size_t>(words * capacity_, 1) * sizeof(std::uint32_t));
}

void RowStore::apply(const RowUpdate& update) {
  if (update.rows.empty()) return;
  const std::size_t rows = std::size_t{*std::max_element(update.rows.begin(), update.rows.end())} + 1;
  reserve(rows);
  set_harmonic_words(update.harmonic_words);
  used_ = std::max(used_, rows);
  name_changed(update.rows);
  scatter(records_, std::as_bytes(std::span(update.records)), kRecordWords, kRecordWords, 0);
  keep(update.rows.size(), true);
  scatter(fades_, std::as_bytes(std::span(update.fades)), 1, 1, 0);
  const std::size_t words = update.harmonic_words;
  if (words > 0) scatter(harmonics_, std::as_bytes(std::span(update.harmonics)), words, words, 0);
  uploaded_.rows += update.rows.size();
}

void RowStore::recolor(const ColorUpdate& update) {
  if (update.rows.empty()) return;
  name_changed(update.rows);
  scatter(records_, std::as_bytes(std::span(update.colors)), 1, kRecordWords, kColorWord);
  uploaded_.rows += update.rows.size();
}

void RowStore::keep_colors() {
  keep(used_, false);
}

void RowStore::keep(std::size_t rows, bool of_changed) {
  const std::array<GLuint, 3> buffers{changed_rows_.get(), records_.get(), kept_.get()};
  glBindBuffersBase(GL_SHADER_STORAGE_BUFFER, 0, static_cast<GLsizei>(buffers.size()), buffers.data());
  glUseProgram(keep_.get());
  glUniform1ui(kKeepRows, static_cast<GLuint>(rows));
  glUniform1i(kKeepChanged, of_changed ? GL_TRUE : GL_FALSE);
  if (rows > 0) glDispatchCompute(static_cast<GLuint>((rows + kThreads - 1) / kThreads), 1, 1);
  glMemoryBarrier(GL_SHADER_STORAGE_BARRIER_BIT | GL_BUFFER_UPDATE_BARRIER_BIT);
}

void RowStore::name_changed(std::span<const std::uint32_t> rows) {
  upload(changed_rows_, std::as_bytes(rows));
  uploaded_.bytes += rows.size_bytes();
}

void RowStore::scatter(const GlBuffer& store, std::span<const std::byte> contents, std::size_t words,
                       std::size_t stride, std::size_t first) {
  upload(changed_, contents);
  uploaded_.bytes += contents.size();
  const std::array<GLuint, 3> buffers{changed_rows_.get(), changed_.get(), store.get()};
  glBindBuffersBase(GL_SHADER_STORAGE_BUFFER, 0, static_cast<GLsizei>(buffers.size()), buffers.data());
  glUseProgram(scatter_.get());
  const auto all = static_cast<GLuint>(contents.size() / sizeof(std::uint32_t));
  glUniform1ui(kScatterEnd, all);
  glUniform3ui(kScatterWords, static_cast<GLuint>(words), static_cast<GLuint>(stride), static_cast<GLuint>(first));
  const std::size_t groups = (all + kThreads - 1) / kThreads;
  for (std::size_t done = 0; done < groups; done += kMostGroups) {
    glUniform1ui(kScatterBegin, static_cast<GLuint>(done * kThreads));
    glDispatchCompute(static_cast<GLuint>(std::min(groups - done, kMostGroups)), 1, 1);
  }
  glMemoryBarrier(GL_SHADER_STORAGE_BARRIER_BIT | GL_BUFFER_UPDATE_BARRIER_BIT);
}

void RowStore::clear() {
  for (const GlBuffer* buffer : {&records_, &fades_}) {
    glClearNamedBufferData(buffer->get(), GL_R32UI, GL_RED_INTEGER, GL_UNSIGNED_INT, nullptr);
  }
  used_ = 0;
}

}  // namespace splatbus::viewer::gl
