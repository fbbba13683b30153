#include "gateway/partial_content.h"

#include <algorithm>
#include <charconv>
#include <optional>

namespace splatbus::gateway {

namespace {

std::optional<std::uint64_t> parse(std::string_view digits) {
  std::uint64_t number = 0;
  const char* end = digits.data() + digits.size();
  const auto parsed = std::from_chars(digits.data(), end, number);
  if (digits.empty() || parsed.ec != std::errc() || parsed.ptr != end) return std::nullopt;
  return number;
}

}  // namespace

PartialContent partial_content(std::string_view range, std::size_t body_bytes) {
  constexpr std::string_view kUnit = "bytes=";
  if (!range.starts_with(kUnit)) return {};
  range.remove_prefix(kUnit.size());
  const std::size_t dash = range.find('-');
  if (dash == std::string_view::npos) return {};
  const auto from = parse(range.substr(0, dash)), to = parse(range.substr(dash + 1));
  const bool has_from = dash > 0, has_to = dash + 1 < range.size();
  if ((has_from && !from) || (has_to && !to) || (!has_from && !has_to) || (from && to && *to < *from)) return {};
  const std::uint64_t size = body_bytes;
  const std::uint64_t first = from ? *from : size - std::min(size, *to);
  const std::uint64_t end = from && to ? std::min(size, *to == UINT64_MAX ? size : *to + 1) : size;
  if (first >= end) return {.kind = PartialContent::Kind::Nothing};
  return {.kind = PartialContent::Kind::Part,
          .first = static_cast<std::size_t>(first),
          .bytes = static_cast<std::size_t>(end - first)};
}

}  // namespace splatbus::gateway
