#include "bus/curve.h"

#include <arpa/inet.h>
#include <fmt/format.h>
#include <netinet/in.h>
#include <spdlog/spdlog.h>

#include <array>
#include <cstdlib>
#include <utility>
#include <vector>

#include "bus/frames.h"
#include "bus/permanent_error.h"
#include "bus/schemes.h"

namespace splatbus::bus {
namespace {

// libzmq 4.3 knows these, and its header names them among the drafts only.
constexpr int zap_enforce_domain = 93;
constexpr const char* user_id = "User-Id";
constexpr const char* zap_endpoint = "inproc://zeromq.zap.01";
constexpr int stop_check_ms = 100;
constexpr std::size_t max_zap_parts = 16;

std::array<std::uint8_t, key_bytes> binary(const Key& key) {
  std::array<std::uint8_t, key_bytes> bytes{};
  for (std::size_t i = 0; i < key_bytes; ++i) {
    bytes[i] = static_cast<std::uint8_t>(std::stoul(key.substr(2 * i, 2), nullptr, 16));
  }
  return bytes;
}

void set_key(zmq::socket_t& socket, int option, const Key& key) {
  require_key(key, "the key");
  const auto bytes = binary(key);
  if (zmq_setsockopt(socket.handle(), option, bytes.data(), bytes.size()) != 0) throw zmq::error_t();
}

std::string environment(const char* name) {
  const char* const value = std::getenv(name);
  return value == nullptr ? "" : value;
}

}  // namespace

void require_transport(const std::string& endpoint) {
  if (endpoint.starts_with(tcp_scheme) || endpoint.starts_with(ipc_scheme)) return;
  const auto scheme = endpoint.find("://");
  throw Error(fmt::format("endpoint '{}': {} is not spoken here: expected ipc:///path or tcp://host:port",
                          printable(endpoint, 200),
                          scheme == std::string::npos ? "that" : printable(endpoint.substr(0, scheme))));
}

bool is_loopback(std::string_view endpoint) {
  if (!endpoint.starts_with(tcp_scheme)) return false;
  const auto rest = endpoint.substr(tcp_scheme.size());
  const std::string host(rest.substr(0, rest.rfind(':')));
  if (host == "localhost" || host == "[::1]") return true;
  in_addr address{};
  return ::inet_pton(AF_INET, host.c_str(), &address) == 1 && (ntohl(address.s_addr) >> 24U) == 127;
}

std::optional<ServerKeys> server_keys(const std::string& endpoint, const ServerKeyFiles& files) {
  if (!endpoint.starts_with(tcp_scheme) || (is_loopback(endpoint) && !files.always)) return std::nullopt;
  const auto key = files.key.empty() ? keys_folder() / "server.key" : std::filesystem::path(files.key);
  const auto allowed = files.allowed.empty() ? keys_folder() / "allowed" : std::filesystem::path(files.allowed);
  std::error_code ignored;
  if (!std::filesystem::exists(key, ignored)) {
    throw PermanentError(
        fmt::format("{}: other machines can reach it, so it needs a key, and there is no {}: make one "
                    "with 'splatbus keys new server'",
                    endpoint, key.string()));
  }
  return ServerKeys{read_key_file(key), std::make_shared<AllowList>(allowed)};
}

std::optional<ClientKeys> client_keys(const std::string& endpoint, const std::string& key_file,
                                      const std::string& server_key) {
  if (!endpoint.starts_with(tcp_scheme)) return std::nullopt;
  std::string file = key_file, server = server_key;
  // Of the environment only where a key is needed: who exports them speaks to this machine as ever.
  if (file.empty() && server.empty() && !is_loopback(endpoint)) {
    file = environment("SPLATBUS_KEY");
    server = environment("SPLATBUS_SERVER_KEY");
  }
  if (file.empty() && server.empty()) {
    if (is_loopback(endpoint)) return std::nullopt;
    throw PermanentError(
        fmt::format("{}: connecting to another machine requires a key (--key FILE or SPLATBUS_KEY) and that machine's "
                    "public key (--server-key or SPLATBUS_SERVER_KEY)",
                    endpoint));
  }
  if (file.empty() || server.empty())
    throw PermanentError(
        fmt::format("{}: a key and the server's public key go together: set both or neither", endpoint));
  require_key(server, "the server's key");
  return ClientKeys{read_key_file(file), server};
}

void use_keys(zmq::socket_t& socket, const ClientKeys& keys) {
  set_key(socket, ZMQ_CURVE_SERVERKEY, keys.server);
  set_key(socket, ZMQ_CURVE_PUBLICKEY, keys.own.public_key);
  set_key(socket, ZMQ_CURVE_SECRETKEY, keys.own.secret_key);
}

void require_keys(zmq::socket_t& socket, const ServerKeys& keys, const Rights& needed) {
  socket.set(zmq::sockopt::curve_server, true);
  set_key(socket, ZMQ_CURVE_SECRETKEY, keys.own.secret_key);
  // The domain is what is needed. Enforced: where nobody answers for it, nobody gets in.
  socket.set(zmq::sockopt::zap_domain, to_text(needed));
  const int enforced = 1;
  if (zmq_setsockopt(socket.handle(), zap_enforce_domain, &enforced, sizeof(enforced)) != 0) throw zmq::error_t();
}

Authenticator::Authenticator(zmq::context_t& context, std::shared_ptr<AllowList> allowed)
    : allowed_(std::move(allowed)), socket_(context, zmq::socket_type::rep) {
  socket_.set(zmq::sockopt::linger, 0);
  socket_.bind(zap_endpoint);
  thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
}

Authenticator::~Authenticator() {
  thread_.request_stop();
  thread_.join();
}

void Authenticator::run(const std::stop_token& stop) {
  while (!stop.stop_requested()) {
    zmq_pollitem_t item{socket_.handle(), 0, ZMQ_POLLIN, 0};
    zmq_poll(&item, 1, stop_check_ms);
    while (serve()) {
    }
  }
}

// RFC 27: version, request id, domain, address, identity, mechanism, credentials.
bool Authenticator::serve() {
  std::vector<std::string> parts;
  zmq::message_t part;
  if (!socket_.recv(part, zmq::recv_flags::dontwait)) return false;
  parts.push_back(part.to_string());
  while (part.more()) {
    (void)socket_.recv(part);
    if (parts.size() < max_zap_parts) parts.push_back(part.to_string());
  }
  const std::string id = parts.size() > 1 ? parts[1] : "";
  std::string code = "400", text = "no key", user;
  if (parts.size() == 7 && parts[0] == "1.0" && parts[5] == "CURVE" && parts[6].size() == key_bytes) {
    for (const char c : parts[6]) user += fmt::format("{:02x}", static_cast<std::uint8_t>(c));
    const auto needed = parse_rights(parts[2]);
    const bool welcome = needed && needed->any() && allowed_->rights_now(user).include(*needed);
    code = welcome ? "200" : "400";
    text = welcome ? "OK" : "not allowed";
  }
  if (code != "200") {
    if (limiter_.allow()) {
      spdlog::warn("refused {} for '{}': {} (key {})", parts.size() > 3 ? printable(parts[3]) : "somebody",
                   parts.size() > 2 ? printable(parts[2]) : "", text, user.empty() ? "none" : user);
    }
    user.clear();
  }
  const std::string reply[] = {"1.0", id, code, text, user, ""};
  for (std::size_t i = 0; i < std::size(reply); ++i) {
    socket_.send(zmq::buffer(reply[i]), i + 1 < std::size(reply) ? zmq::send_flags::sndmore : zmq::send_flags::none);
  }
  return true;
}

Key sender_key(const zmq::message_t& message) {
  const char* const user = zmq_msg_gets(message.handle(), user_id);
  return user == nullptr ? Key() : Key(user);
}

Rights sender_rights(const zmq::message_t& message, AllowList* allowed) {
  const Key key = sender_key(message);
  if (key.empty()) return Rights::all();
  return allowed == nullptr ? Rights() : allowed->rights_of(key);
}

}  // namespace splatbus::bus
