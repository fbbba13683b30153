#pragma once

// Part of server.cpp: requests and responses on a connection.

#include <unistd.h>

#include <algorithm>
#include <array>
#include <boost/asio/write.hpp>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "gateway/boost_types.h"
#include "gateway/site.h"

namespace splatbus::gateway {

using HttpRequest = http::request<http::string_body>;

inline constexpr std::size_t kMaxHeaderBytes = 8192, kMaxTargetBytes = 2048;
inline constexpr std::size_t kSliceBytes = 256 << 10;
inline constexpr double kSliceS = 20;  ///< in which a client takes one

inline Request view_of(const HttpRequest& request) {
  const auto field = [&](http::field name) -> std::optional<std::string_view> {
    const auto found = request.find(name);
    if (found == request.end()) return std::nullopt;
    return std::string_view(found->value().data(), found->value().size());
  };
  const auto view = [](beast::string_view text) { return std::string_view(text.data(), text.size()); };
  return {.method = view(request.method_string()),
          .target = view(request.target()),
          .host = field(http::field::host).value_or(""),
          .body = request.body(),
          .origin = field(http::field::origin),
          .authorization = field(http::field::authorization),
          .if_none_match = field(http::field::if_none_match),
          .if_range = field(http::field::if_range),
          .range = field(http::field::range),
          .content_type = field(http::field::content_type),
          .protocols = field(http::field::sec_websocket_protocol)};
}

/// Of what two parsers could understand in two ways, nothing is served.
inline bool is_plain(const HttpRequest& request) {
  return request.count(http::field::transfer_encoding) == 0 && request.count(http::field::content_length) <= 1 &&
         request.count(http::field::host) == 1 && request.count(http::field::origin) <= 1 &&
         request.target().starts_with('/') && request.target().size() <= kMaxTargetBytes &&
         (request.body().empty() || request.method() == http::verb::post);
}

inline Response plain(int status, std::string text) {
  const std::size_t bytes = text.size();
  return {.status = status, .fields = {}, .body = std::make_shared<const std::string>(std::move(text)), .bytes = bytes};
}

inline Response refusal_of(const beast::error_code& error) {
  if (error == http::error::header_limit || error == http::error::buffer_overflow) {
    return plain(431, "header too large\n");
  }
  if (error == http::error::body_limit) return plain(413, "body too large\n");
  return plain(400, "not understood\n");
}

// GCC 12 destroys twice what is made in an expression with co_await: there, everything has a name.

/// Sends it; false when the connection is of no use any more.
inline asio::awaitable<bool> respond(Connection& connection, const Response& response, bool head, bool keep) {
  http::response<http::empty_body> message(static_cast<http::status>(response.status), 11);
  for (const auto& [name, value] : common_fields()) message.set(name, value);
  for (const auto& [name, value] : response.fields) message.set(name, value);
  if (response.body || response.file) message.set(http::field::content_type, response.type);
  if (response.status != 204 && response.status != 304) message.content_length(response.bytes);
  message.keep_alive(keep);
  http::response_serializer<http::empty_body> serializer(message);
  auto& lowest = connection.next_layer();
  lowest.expires_after(seconds(kSliceS));
  if (const auto [error, sent] = co_await http::async_write_header(connection, serializer, kNoThrow); error)
    co_return false;
  std::vector<char> read;  // of a file
  const std::size_t end = response.first + response.bytes;
  for (std::size_t at = response.first; !head && at < end;) {
    asio::const_buffer slice;
    if (response.file) {
      read.resize(std::min(kSliceBytes, end - at));
      const ssize_t got = ::pread(response.file->file.get(), read.data(), read.size(), static_cast<off_t>(at));
      if (got <= 0) co_return false;
      slice = asio::buffer(read.data(), static_cast<std::size_t>(got));
    } else {
      slice = asio::buffer(response.body->data() + at, std::min(kSliceBytes, end - at));
    }
    at += slice.size();
    lowest.expires_after(seconds(kSliceS));
    if (const auto [error, sent] = co_await asio::async_write(connection, slice, kNoThrow); error) co_return false;
  }
  co_return keep;
}

/// Ends a connection so that its last response arrives even where something of the request was left unread.
inline asio::awaitable<void> finish(Connection& connection) {
  auto& lowest = connection.next_layer();
  lowest.expires_after(std::chrono::seconds(1));
  if (connection.tls() != nullptr) co_await connection.tls()->next_layer().async_shutdown(kNoThrow);
  beast::error_code ignored;
  lowest.socket().shutdown(asio::ip::tcp::socket::shutdown_send, ignored);
  std::array<char, 4096> rest;
  for (int i = 0; i < 64; ++i) {
    const auto [error, bytes] = co_await lowest.async_read_some(asio::buffer(rest), kNoThrow);
    if (error) co_return;
  }
}

}  // namespace splatbus::gateway
