#pragma once

#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <thread>
#include <zmq.hpp>

#include "bus/keys.h"

namespace splatbus::bus {

/// Makes sure that a ZeroMQ endpoint is one that splatbus speaks on: ipc:// or tcp://. Throws Error naming it; so are
/// ws, wss, pgm, epgm, norm, udp, tipc, vmci and inproc refused.
void require_transport(const std::string& endpoint);

/// Whether a tcp endpoint's host is this machine by its very text: 127.x.x.x, [::1] or localhost. Only there, and on
/// ipc, may anybody speak without a key.
[[nodiscard]] bool is_loopback(std::string_view endpoint);

/// A server's side of keys, by files; empty names mean those of keys_folder().
struct ServerKeyFiles {
  std::string key, allowed;
  bool always = false;  ///< on the loopback address too
};
struct ServerKeys {
  KeyPair own;
  std::shared_ptr<AllowList> allowed;
};

/// What a server bound to `endpoint` needs: nullopt where it may do without keys. Throws Error that says what to do
/// when there should be a key and is none.
[[nodiscard]] std::optional<ServerKeys> server_keys(const std::string& endpoint, const ServerKeyFiles& files);

/// A client's side: its own pair and the server's public key.
struct ClientKeys {
  KeyPair own;
  Key server;
};

/// From a key file and the server's public key; where both are empty from SPLATBUS_KEY and SPLATBUS_SERVER_KEY. Nullopt
/// where there are none and `endpoint` needs none. Throws Error.
[[nodiscard]] std::optional<ClientKeys> client_keys(const std::string& endpoint, const std::string& key_file,
                                                    const std::string& server_key);

/// Before connect().
void use_keys(zmq::socket_t& socket, const ClientKeys& keys);

/// Before bind(): whoever connects to what is bound from then on needs a key that is allowed all of `needed`, which is
/// not nothing. Without an Authenticator in the socket's context nobody gets in.
void require_keys(zmq::socket_t& socket, const ServerKeys& keys, const Rights& needed);

/// The ZAP handler of a ZeroMQ context: the allow-list, as it is then, decides at each handshake. Nobody gets in by
/// another mechanism than CURVE. Make it before sockets bind; it goes before the context does.
class Authenticator {
 public:
  Authenticator(zmq::context_t& context, std::shared_ptr<AllowList> allowed);
  ~Authenticator();
  Authenticator(const Authenticator&) = delete;
  Authenticator& operator=(const Authenticator&) = delete;

 private:
  void run(const std::stop_token& stop);
  bool serve();

  std::shared_ptr<AllowList> allowed_;
  zmq::socket_t socket_;
  LogLimiter limiter_;
  std::jthread thread_;
};

/// The public key that a message's sender proved to have, as the Authenticator saw it; empty for one without.
[[nodiscard]] Key sender_key(const zmq::message_t& message);

/// The rights of a message's sender now: all of them where it needed no key, by the allow-list where it has one.
[[nodiscard]] Rights sender_rights(const zmq::message_t& message, AllowList* allowed);

}  // namespace splatbus::bus
