// fmt 9 compiles its formatter into libfmt and declares that nowhere, so every source that logs compiles it again: half
// of such a source's time. Found before fmt's own header where libfmt has it (SplatbusDependencies.cmake).
#pragma once

#include_next <fmt/format.h>

extern template void fmt::detail::vformat_to<char>(fmt::detail::buffer<char>&, fmt::basic_string_view<char>,
                                                   fmt::basic_format_args<fmt::buffer_context<char>>,
                                                   fmt::detail::locale_ref);
