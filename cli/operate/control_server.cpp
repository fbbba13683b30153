#include "control_server.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>

#include <array>
#include <nlohmann/json.hpp>
#include <utility>

#include "bus/error.h"

namespace splatbus::cli {

namespace {

using Json = nlohmann::json;

constexpr std::size_t kMaxConnections = 64;
constexpr std::size_t kMaxLinesWaiting = 4096;
constexpr int kLookAtFolderEveryMs = 1000;

}  // namespace

ControlServer::ControlServer(bus::Address bus)
    : bus_(std::move(bus)),
      listener_(std::make_unique<ControlListener>(bus_)),
      wake_(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {}

ControlServer::~ControlServer() {
  stop();
}

void ControlServer::stop() {
  stop_.request_stop();
  eventfd_write(wake_.get(), 1);
  if (thread_.joinable()) thread_.join();
  listener_.reset();
  forget_the_gone(true);
}

void ControlServer::handle(const std::string& verb, Handler handler) {
  handlers_[verb] = std::move(handler);
}

void ControlServer::start() {
  thread_ = std::jthread([this] { accept_until_stopped(); });
}

void ControlServer::accept_until_stopped() {
  while (!stop_.stop_requested()) {
    std::array<pollfd, 2> items{pollfd{wake_.get(), POLLIN, 0}, pollfd{listener_ ? listener_->fd() : -1, POLLIN, 0}};
    poll(items.data(), items.size(), kLookAtFolderEveryMs);
    if ((items[1].revents & POLLIN) != 0) accept_one();
    forget_the_gone(false);
    if (listener_ && listener_->intact()) continue;
    listener_.reset();
    try {
      listener_ = std::make_unique<ControlListener>(bus_);
    } catch (const std::exception&) {  // later it may be possible
    }
  }
}

void ControlServer::accept_one() {
  bus::FileDescriptor fd(accept4(listener_->fd(), nullptr, nullptr, SOCK_CLOEXEC));
  if (!fd.valid()) return;
  const std::scoped_lock lock(mutex_);
  if (connections_.size() >= kMaxConnections) return;
  try {
    connections_.emplace_back(std::move(fd));
  } catch (const bus::Error&) {  // another user's
    return;
  }
  Connection& connection = connections_.back();
  connection.thread = std::jthread([this, &connection] { serve(connection); });
}

void ControlServer::serve(Connection& connection) {
  try {
    for (;;) {
      const auto request = connection.socket.receive();
      if (!request || !answer(connection, *request)) break;
    }
  } catch (const std::exception& error) {
    connection.socket.send({{"ok", false}, {"error", error.what()}});
  }
  const std::scoped_lock lock(mutex_);
  connection.done = true;
  shutdown(connection.socket.fd(), SHUT_RDWR);
}

bool ControlServer::answer(Connection& connection, const Json& request) {
  const auto refuse = [&](const std::string& why) { return connection.socket.send({{"ok", false}, {"error", why}}); };
  try {
    if (request.value("version", 0) != kControlVersion) {
      return refuse(fmt::format("this supervisor speaks version {}: it is of another splatbus", kControlVersion));
    }
    const std::string verb = request.value("verb", "");
    if (verb == "attach") {
      stream(connection);
      return false;
    }
    const auto handler = handlers_.find(verb);
    if (handler == handlers_.end()) return refuse(fmt::format("this supervisor does not know the verb '{}'", verb));
    const Tell tell = [&](const std::string& progress) { connection.socket.send({{"progress", progress}}); };
    Json result = handler->second(request, tell, stop_.get_token());
    result["ok"] = true;
    return connection.socket.send(result);
  } catch (const std::exception& error) {
    return refuse(error.what());
  }
}

void ControlServer::stream(Connection& connection) {
  {
    const std::scoped_lock lock(mutex_);
    connection.attached = true;
  }
  if (!connection.socket.send({{"ok", true}})) return;
  std::unique_lock lock(mutex_);
  for (;;) {
    changed_.wait(lock, [&] { return !connection.lines.empty() || stop_.stop_requested(); });
    if (connection.lines.empty()) return;
    std::deque<std::string> lines = std::exchange(connection.lines, {});
    const std::size_t missed = std::exchange(connection.missed, 0);
    lock.unlock();
    for (std::string& line : lines) {
      if (!connection.socket.send_line(std::move(line))) return;
    }
    if (missed > 0 && !connection.socket.send({{"missed", missed}})) return;
    lock.lock();
  }
}

void ControlServer::publish_line(const std::string& line) {
  const std::scoped_lock lock(mutex_);
  for (Connection& connection : connections_) {
    if (!connection.attached || connection.done) continue;
    if (connection.lines.size() < kMaxLinesWaiting) {
      connection.lines.push_back(line);
    } else {
      ++connection.missed;
    }
  }
  changed_.notify_all();
}

void ControlServer::forget_the_gone(bool all) {
  std::list<Connection> gone;
  {
    const std::scoped_lock lock(mutex_);
    for (auto it = connections_.begin(); it != connections_.end();) {
      const auto next = std::next(it);
      if (all) shutdown(it->socket.fd(), SHUT_RD);
      if (all || it->done) gone.splice(gone.end(), connections_, it);
      it = next;
    }
  }
  changed_.notify_all();
}

}  // namespace splatbus::cli
