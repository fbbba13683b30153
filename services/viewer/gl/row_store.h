#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "gl/objects.h"
#include "viewer/gl/rows.h"

namespace splatbus::viewer::gl {

/// The rows in the memory of the current context's device, in buffers that grow. What is uploaded is what changed.
class RowStore {
 public:
  struct Uploaded {
    std::size_t rows = 0, bytes = 0;
  };

  RowStore();

  /// Its colors are those to keep as well.
  void apply(const RowUpdate& update);
  void recolor(const ColorUpdate& update);
  /// The colors that there are become those from which Frame::color_part goes; nothing is uploaded.
  void keep_colors();
  /// Every row is free again.
  void clear();

  /// Rows that were ever used since the last clear().
  [[nodiscard]] std::size_t used() const { return used_; }
  [[nodiscard]] std::size_t capacity() const { return capacity_; }
  [[nodiscard]] std::size_t harmonic_words() const { return harmonic_words_; }
  [[nodiscard]] const Uploaded& uploaded() const { return uploaded_; }

  [[nodiscard]] GLuint records() const { return records_.get(); }      ///< uvec4[2] a row: GpuRecord
  [[nodiscard]] GLuint fades() const { return fades_.get(); }          ///< float a row
  [[nodiscard]] GLuint kept() const { return kept_.get(); }            ///< uint a row: colors as they were
  [[nodiscard]] GLuint harmonics() const { return harmonics_.get(); }  ///< uint[harmonic_words()] a row

 private:
  void reserve(std::size_t rows);
  void set_harmonic_words(std::size_t words);
  void name_changed(std::span<const std::uint32_t> rows);
  /// To the rows that name_changed() had, `words` from word `first` of a row's `stride` in `store`.
  void scatter(const GlBuffer& store, std::span<const std::byte> contents, std::size_t words, std::size_t stride,
               std::size_t first);

  /// Of the first `rows` that name_changed() had, or of all.
  void keep(std::size_t rows, bool of_changed);

  GlProgram scatter_, keep_;
  GlBuffer records_, fades_, kept_, harmonics_;
  GlBuffer changed_rows_, changed_;
  std::size_t capacity_ = 0, used_ = 0, harmonic_words_ = 0;
  Uploaded uploaded_;
};

}  // namespace splatbus::viewer::gl
