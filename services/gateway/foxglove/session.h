#pragma once

// Part of server.cpp: of Boost.Beast, which is slow to compile.

#include <unistd.h>

#include <array>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>

#include "gateway/browser_socket.h"
#include "gateway/foxglove/hub.h"
#include "gateway/model_files.h"

namespace splatbus::gateway::foxglove {

/// What sessions have in common. Outlives them.
struct Door {
  Hub& hub;
  ModelFiles& models;
};

/// One client of Foxglove's protocol.
class Session final : public BrowserSocket {
 public:
  Session(Connection connection, Relay& relay, Door& door, Site::Admission admission)
      : BrowserSocket(std::move(connection), relay, std::move(admission)),
        door_(door),
        idle_(socket_.get_executor(), asio::steady_timer::time_point::max()) {}
  ~Session() override { door_.hub.leave(client_); }

 private:
  static constexpr std::size_t kMaxAssetBytes = std::size_t{32} << 20;
  static constexpr double kAssetS = 60;

  void opened() override {
    client_ = door_.hub.join([executor = socket_.get_executor(), weak = weak_from_this()] {
      asio::post(executor, [weak] {
        if (const auto self = weak.lock()) static_cast<Session&>(*self).idle_.cancel();
      });
    });
  }

  asio::awaitable<void> write_messages() override {
    while (!stopped_ && !closing_) {
      if (!door_.hub.reads(client_)) {
        relay_.traffic.refuse(Refusal::Stalled);
        co_return;
      }
      const std::optional<OutgoingMessage> next = door_.hub.take(client_);
      if (!next) {
        co_await idle_.async_wait(kNoThrow);
        continue;
      }
      socket_.binary(next->binary);
      const std::string_view payload = next->payload ? std::string_view(*next->payload) : std::string_view();
      const std::array<asio::const_buffer, 2> message{asio::buffer(next->head), asio::buffer(payload)};
      const bool written = co_await write(message);
      if (!written) co_return;
    }
  }
  void wake_writer() override { idle_.cancel(); }

  std::string take(std::span<const std::uint8_t> message, bool binary) override {
    std::optional<Hub::AssetRequest> asset;
    const auto reception = door_.hub.receive(client_, message, binary, rights, bus::now_ns(), asset);
    if (reception == Hub::Reception::Malformed) return "not understood";
    if (reception == Hub::Reception::Forbidden) relay_.traffic.refuse(Refusal::Forbidden);
    if (!asset) return {};
    constexpr std::string_view kPackage = "package://splatbus";
    const bool known = asset->uri.starts_with(kPackage);
    const auto format =
        known ? ModelFiles::format_of_path(std::string_view(asset->uri).substr(kPackage.size())) : std::nullopt;
    if (!format || fetching_) {
      const char* problem = format ? "one at a time" : "there are package://splatbus/model.glb, .ply and .spz";
      door_.hub.answer(client_, foxglove::asset(asset->id, nullptr, problem));
      return {};
    }
    fetching_ = true;
    asio::co_spawn(socket_.get_executor(), fetch(shared_from_this(), asset->id, *format), asio::detached);
    return {};
  }

  static asio::awaitable<void> fetch(std::shared_ptr<BrowserSocket> self, std::uint32_t id, splats::Format format) {
    auto& session = static_cast<Session&>(*self);
    asio::steady_timer timer(session.socket_.get_executor());
    const std::int64_t began_ns = bus::now_ns();
    ModelFiles::Found found;
    while (!session.stopped_ && static_cast<double>(bus::now_ns() - began_ns) / 1e9 < kAssetS) {
      found = session.door_.models.find(format, bus::now_ns());
      if (found.file || !found.problem.empty()) break;
      timer.expires_after(std::chrono::milliseconds(100));
      co_await timer.async_wait(kNoThrow);
    }
    std::string problem = found.file ? "" : found.problem.empty() ? "nothing has come yet" : found.problem;
    Payload data;
    if (found.file && found.file->bytes > kMaxAssetBytes) {
      problem = "larger than 32 MiB: fetch it over HTTP";
    } else if (found.file) {
      std::string bytes(found.file->bytes, '\0');
      const ssize_t got = ::pread(found.file->file.get(), bytes.data(), bytes.size(), 0);
      if (got == static_cast<ssize_t>(bytes.size()))
        data = std::make_shared<const std::string>(std::move(bytes));
      else
        problem = "it could not be read";
    }
    session.fetching_ = false;
    session.door_.hub.answer(session.client_, foxglove::asset(id, std::move(data), problem));
  }

  Door& door_;
  Hub::ClientId client_ = 0;
  asio::steady_timer idle_;
  bool fetching_ = false;
};

}  // namespace splatbus::gateway::foxglove
