#pragma once

#include <condition_variable>
#include <deque>
#include <functional>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <nlohmann/json_fwd.hpp>
#include <stop_token>
#include <string>
#include <thread>

#include "bus/address.h"
#include "bus/file_descriptor.h"
#include "control_socket.h"

namespace splatbus::cli {

/// Answers the operator's commands over a bus's control socket, each connection on a thread of its own:
///   {"version": 1, "verb": "restart", "services": ["trainer"]}  ->  {"ok": true, ...} or {"ok": false, "error": "why"}
/// Before its answer a verb may send lines {"progress": "words"}. One connection may ask one thing after another.
class ControlServer {
 public:
  using Tell = std::function<void(const std::string& progress)>;
  /// What a verb does with a request; the answer's "ok" is added. What it throws is the answer's "error". Must return
  /// soon once the server's stop is asked for.
  using Handler =
      std::function<nlohmann::json(const nlohmann::json& request, const Tell& tell, const std::stop_token& stop)>;

  /// Takes the place of the bus's supervisor; answers from start() on. Throws SupervisorRuns, or bus::Error.
  explicit ControlServer(bus::Address bus);
  ~ControlServer();  ///< stop()
  ControlServer(const ControlServer&) = delete;
  ControlServer& operator=(const ControlServer&) = delete;

  /// Before start().
  void handle(const std::string& verb, Handler handler);
  void start();
  /// Closes all connections and waits for the verbs under way, whose stop is asked for: no handler runs after this, so
  /// that what they refer to may go. The place is given up first: who hears a connection close may start another
  /// supervisor.
  void stop();

  /// Passes a JSON object on to everybody who asked with the verb "attach". Never blocks: who reads too slowly misses
  /// some, and is told how many. Any thread.
  void publish_line(const std::string& line);

 private:
  struct Connection {
    explicit Connection(bus::FileDescriptor fd) : socket(std::move(fd)) {}
    LineSocket socket;
    bool attached = false, done = false;
    std::deque<std::string> lines;  ///< to be sent
    std::size_t missed = 0;
    std::jthread thread;
  };

  void accept_until_stopped();
  void accept_one();
  void serve(Connection& connection);
  bool answer(Connection& connection, const nlohmann::json& request);
  void stream(Connection& connection);
  void forget_the_gone(bool all);

  bus::Address bus_;
  std::unique_ptr<ControlListener> listener_;
  bus::FileDescriptor wake_;
  std::map<std::string, Handler> handlers_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::list<Connection> connections_;
  std::stop_source stop_;
  std::jthread thread_;
};

}  // namespace splatbus::cli
