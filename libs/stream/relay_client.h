#pragma once

#include <charconv>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <system_error>

namespace splatbus::stream {

// The frame by which a relay names who of its own clients speaks, behind that of the client's rights: bounds that hold
// for one address then hold for each of them, and not for the relay.

inline constexpr std::string_view kClientFrame = "client ";

/// `client`: the same whenever somebody of that address speaks.
[[nodiscard]] inline std::string client_frame(std::uint64_t client) {
  return std::string(kClientFrame) + std::to_string(client);
}

/// Nullopt where the frame is none: it is the message's own first one.
[[nodiscard]] inline std::optional<std::uint64_t> parse_client_frame(std::string_view frame) {
  if (!frame.starts_with(kClientFrame)) return std::nullopt;
  frame.remove_prefix(kClientFrame.size());
  std::uint64_t client = 0;
  const auto parsed = std::from_chars(frame.data(), frame.data() + frame.size(), client);
  if (parsed.ec != std::errc() || parsed.ptr != frame.data() + frame.size()) return std::nullopt;
  return client;
}

}  // namespace splatbus::stream
