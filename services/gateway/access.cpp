#include "gateway/access.h"

#include <arpa/inet.h>
#include <fmt/format.h>
#include <openssl/crypto.h>
#include <openssl/sha.h>
#include <spdlog/spdlog.h>
#include <sys/stat.h>

#include <algorithm>
#include <charconv>
#include <fstream>
#include <sstream>
#include <stdexcept>
#include <utility>

namespace splatbus::gateway {

namespace {

constexpr std::size_t kMaxTokens = 4096;

bool parse_hex(std::string_view text, std::array<std::uint8_t, 32>& out) {
  if (text.size() != 2 * out.size()) return false;
  for (std::size_t i = 0; i < out.size(); ++i) {
    const char* begin = text.data() + 2 * i;
    if (std::from_chars(begin, begin + 2, out[i], 16).ptr != begin + 2) return false;
  }
  return true;
}

bool same_text(std::string_view a, std::string_view b) {
  const auto lower = [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c; };
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [&](char x, char y) { return lower(x) == lower(y); });
}

/// What follows the scheme.
std::string_view authority(std::string_view origin) {
  const std::size_t at = origin.find("://");
  return at == std::string_view::npos ? std::string_view() : origin.substr(at + 3);
}

bool is_address(const std::string& host) {
  in6_addr buffer{};
  return ::inet_pton(AF_INET, host.c_str(), &buffer) == 1 || ::inet_pton(AF_INET6, host.c_str(), &buffer) == 1;
}

}  // namespace

Tokens::Tokens(std::string path) : path_(std::move(path)) {
  if (!path_.empty()) read();
}

std::optional<Tokens::Version> Tokens::version() const {
  struct stat found {};
  if (::stat(path_.c_str(), &found) != 0) return std::nullopt;
  return Version{.modified_ns = found.st_mtim.tv_sec * 1'000'000'000 + found.st_mtim.tv_nsec,
                 .inode = found.st_ino,
                 .bytes = static_cast<std::uint64_t>(found.st_size)};
}

void Tokens::read() {
  entries_.clear();
  version_ = version();
  struct stat found {};
  std::ifstream file(path_);
  if (!file || ::stat(path_.c_str(), &found) != 0) throw std::runtime_error(path_ + ": cannot be read");
  if ((found.st_mode & (S_IWGRP | S_IWOTH)) != 0) {
    throw std::runtime_error(path_ + ": users other than its owner may write to it (chmod 600)");
  }
  std::vector<Entry> entries;
  std::string line;
  for (int number = 1; std::getline(file, line); ++number) {
    std::istringstream words(line.substr(0, line.find('#')));
    std::string names, hash;
    if (!(words >> names)) continue;
    const auto rights = bus::parse_rights(names);
    Entry entry;
    if (!rights || !rights->view || !(words >> hash) || !parse_hex(hash, entry.hash)) {
      throw std::runtime_error(fmt::format(
          "{}:{}: expected view, or with steer, probe or control such as view,steer; and a SHA-256 of 64 hex digits",
          path_, number));
    }
    entry.rights = *rights;
    if (entries.size() == kMaxTokens) {
      throw std::runtime_error(fmt::format("{}:{}: more than {} tokens", path_, number, kMaxTokens));
    }
    entries.push_back(entry);
  }
  entries_ = std::move(entries);
}

bool Tokens::refresh() {
  if (path_.empty() || version() == version_) return false;
  try {
    read();
    spdlog::info("{}: {} tokens", path_, entries_.size());
  } catch (const std::runtime_error& error) {
    spdlog::error("nobody is let in: {}", error.what());
  }
  return true;
}

std::optional<bus::Rights> Tokens::find(std::string_view token) const {
  Hash hash{};
  ::SHA256(reinterpret_cast<const unsigned char*>(token.data()), token.size(), hash.data());
  std::optional<bus::Rights> found;
  for (const Entry& entry : entries_) {
    if (::CRYPTO_memcmp(entry.hash.data(), hash.data(), hash.size()) == 0) found = entry.rights;
  }
  return found;
}

OriginRule::OriginRule(std::string_view origins, bool any_host) : any_host_(any_host) {
  std::string text(origins);
  std::replace(text.begin(), text.end(), ',', ' ');
  std::istringstream words(text);
  for (std::string origin; words >> origin;) {
    if (authority(origin).empty()) {
      throw std::runtime_error(fmt::format("origins: '{}' is none, https://example.org would be", origin));
    }
    origins_.push_back(std::move(origin));
  }
}

bool OriginRule::host_allowed(std::string_view host) const {
  const auto parsed = parse_host_port(host);
  if (!parsed) return false;
  if (any_host_ || same_text(parsed->host, "localhost") || is_address(parsed->host)) return true;
  return std::any_of(origins_.begin(), origins_.end(), [&](const std::string& origin) {
    const auto own = parse_host_port(authority(origin));
    return own && same_text(own->host, parsed->host);
  });
}

bool OriginRule::listed(std::string_view origin) const {
  return std::any_of(origins_.begin(), origins_.end(), [&](const auto& other) { return same_text(other, origin); });
}

bool OriginRule::origin_allowed(const std::optional<std::string_view>& origin, std::string_view host) const {
  if (!origin) return true;
  // Its scheme may differ from ours: TLS can end in front of us.
  const bool web = origin->starts_with("http://") || origin->starts_with("https://");
  return (web && !host.empty() && same_text(authority(*origin), host)) || listed(*origin);
}

std::optional<HostPort> parse_host_port(std::string_view text) {
  const bool bracketed = text.starts_with('[');
  const std::size_t end = bracketed ? text.find(']') : std::min(text.find(':'), text.size());
  if (end == std::string_view::npos || end == (bracketed ? 1U : 0U)) return std::nullopt;
  HostPort result{.host = std::string(text.substr(bracketed ? 1 : 0, bracketed ? end - 1 : end))};
  const auto plain = [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '.' || c == '-' ||
           c == '_' || c == ':';
  };
  if (!std::all_of(result.host.begin(), result.host.end(), plain)) return std::nullopt;
  std::string_view port = text.substr(bracketed ? end + 1 : end);
  if (port.empty()) return result;
  if (!port.starts_with(':') || port.size() < 2) return std::nullopt;
  port.remove_prefix(1);
  const auto [stop, error] = std::from_chars(port.data(), port.data() + port.size(), result.port);
  if (error != std::errc() || stop != port.data() + port.size()) return std::nullopt;
  return result;
}

bool is_loopback(std::string_view host) {
  if (same_text(host, "localhost") || host == "::1") return true;
  in_addr v4{};
  return ::inet_pton(AF_INET, std::string(host).c_str(), &v4) == 1 && (ntohl(v4.s_addr) >> 24U) == 127;
}

}  // namespace splatbus::gateway
