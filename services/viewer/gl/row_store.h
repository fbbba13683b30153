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

  void apply(const RowUpdate& update);
  void recolor(const ColorUpdate& update);
  void set_harmonics(const Harmonics& harmonics);
  /// Every row is free again.
  void clear();
  /// For the program that draws.
  void bind() const;

  [[nodiscard]] int harmonic_words() const { return harmonic_words_; }
  [[nodiscard]] const Uploaded& uploaded() const { return uploaded_; }

 private:
  void reserve(std::size_t rows);
  void scatter(std::span<const std::uint32_t> rows, std::span<const std::byte> contents, std::span<const float> fades);

  GlProgram scatter_;
  GlBuffer records_, fades_, harmonics_;
  GlBuffer changed_rows_, changed_, changed_fades_;
  std::size_t capacity_ = 0;
  int harmonic_words_ = 0;
  Uploaded uploaded_;
};

}  // namespace splatbus::viewer::gl
