#pragma once

#include <string_view>

#include "gl/objects.h"

namespace splatbus {

/// Of whole texts. Throw std::runtime_error with the compiler's words.
[[nodiscard]] GlProgram make_program(std::string_view vertex_text, std::string_view fragment_text);
[[nodiscard]] GlProgram make_compute_program(std::string_view text);

}  // namespace splatbus
