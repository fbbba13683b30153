#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>

namespace splatbus::viewer {

/// How packets get to a streamer and come from it. Connects by itself, again and again. One thread.
class PacketLink {
 public:
  virtual ~PacketLink() = default;
  PacketLink(const PacketLink&) = delete;
  PacketLink& operator=(const PacketLink&) = delete;

  /// Until something has come, the descriptor `wake` (-1: none) can be read, or the time is over.
  virtual void wait(std::chrono::milliseconds timeout, int wake) = 0;

  struct Message {
    std::span<const std::uint8_t> packet, payload;  ///< valid until the next call
  };
  /// Without waiting; nullopt when nothing has come.
  [[nodiscard]] virtual std::optional<Message> receive() = 0;

  /// While there is no connection, and while the other side does not read, a few wait and others are dropped.
  virtual void send(std::span<const std::uint8_t> packet) = 0;

  /// True once after each connection that the streamer knows nothing of.
  [[nodiscard]] virtual bool take_opened() { return false; }
  /// Nullopt where nobody measures it.
  [[nodiscard]] virtual std::optional<double> round_trip_ms() const { return std::nullopt; }
  /// Something for the log, once.
  [[nodiscard]] virtual std::optional<std::string> take_notice() { return std::nullopt; }

 protected:
  PacketLink() = default;
};

/// A ZeroMQ endpoint; `key` and `server_key` as bus::client_keys() has them. Throws bus::Error naming it.
[[nodiscard]] std::unique_ptr<PacketLink> make_zmq_link(const std::string& endpoint, const std::string& key,
                                                        const std::string& server_key);

struct WebLinkOptions {
  std::string url;    ///< as parse_web_address() takes it
  std::string token;  ///< empty: the URL's, else SPLATBUS_TOKEN
  std::string ca;     ///< PEM file of who may vouch for a server; empty: whom this system trusts
  std::chrono::milliseconds first_pause{250}, longest_pause{5000};  ///< between tries, doubled each time
};
/// A gateway's WebSocket. A server whose certificate does not hold for its name is not spoken to. Throws bus::Error
/// naming the URL, or the file.
[[nodiscard]] std::unique_ptr<PacketLink> make_web_link(const WebLinkOptions& options);

}  // namespace splatbus::viewer
