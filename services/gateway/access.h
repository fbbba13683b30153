#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "bus/rights.h"

namespace splatbus::gateway {

/// Who may come in: a file with a line for each token, `RIGHTS SHA256 [name]`. RIGHTS are those of bus::parse_rights,
/// "view,steer", view among them; SHA256 is the token's, in hex, so that who reads the file cannot use it. '#' begins a
/// comment. Not thread-safe.
class Tokens {
 public:
  Tokens() = default;
  /// Throws std::runtime_error that names the file, and the line where one is wrong; also when others than its owner
  /// may write to it.
  explicit Tokens(std::string path);

  [[nodiscard]] bool required() const { return !path_.empty(); }
  /// The rights that a token stands for. Takes the same time whichever it is, and whether there is one.
  [[nodiscard]] std::optional<bus::Rights> find(std::string_view token) const;
  /// Reads the file again when it has changed; a new one that is wrong lets nobody in, and is logged. True when
  /// anything changed.
  bool refresh();

 private:
  using Hash = std::array<std::uint8_t, 32>;
  struct Entry {
    Hash hash{};
    bus::Rights rights;
  };
  struct Version {
    std::int64_t modified_ns = 0;
    std::uint64_t inode = 0, bytes = 0;
    bool operator==(const Version&) const = default;
  };
  void read();
  [[nodiscard]] std::optional<Version> version() const;

  std::string path_;
  std::vector<Entry> entries_;
  std::optional<Version> version_;
};

/// Which pages may speak to us, by the Origin and Host of their requests.
class OriginRule {
 public:
  /// `origins`: further ones besides our own, as browsers write them ("https://example.org"), separated by commas or
  /// spaces. `any_host`: a Host that is neither an address nor localhost nor of `origins` is all right; where nothing
  /// but the address that we listen on protects us it is not, since any page can have a name of its own resolve to it
  /// (DNS rebinding).
  OriginRule(std::string_view origins, bool any_host);

  [[nodiscard]] bool host_allowed(std::string_view host) const;
  /// No Origin at all is allowed: such a client is no page.
  [[nodiscard]] bool origin_allowed(const std::optional<std::string_view>& origin, std::string_view host) const;
  /// Whether it is one of `origins`.
  [[nodiscard]] bool listed(std::string_view origin) const;

 private:
  std::vector<std::string> origins_;
  bool any_host_;
};

/// "127.0.0.1:7680", "[::1]:7680", "localhost:7680" taken apart; without a port it is 0. Nullopt for anything else
/// than a name or an address, and a port.
struct HostPort {
  std::string host;  ///< without brackets
  std::uint16_t port = 0;
};
[[nodiscard]] std::optional<HostPort> parse_host_port(std::string_view text);

/// Of an address or localhost: only this machine can reach it.
[[nodiscard]] bool is_loopback(std::string_view host);

}  // namespace splatbus::gateway
