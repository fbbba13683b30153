#pragma once

#include <condition_variable>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "bus/file_descriptor.h"
#include "link_schedule.h"

namespace splatbus::cli {

/// A port on the loopback address that nobody has now. Throws std::runtime_error.
[[nodiscard]] std::uint16_t free_loopback_port();

/// Forwards tcp connections to another port of the loopback address as a link of that shape would, on a thread of its
/// own. Who tries to connect in a cut, again and again as our viewers do, has a connection with the first try behind
/// it.
class TcpRelay {
 public:
  /// Listens on a port of the loopback address. Throws std::runtime_error.
  TcpRelay(std::uint16_t to_port, const LinkShape& shape, std::uint64_t seed = 0);
  ~TcpRelay();
  TcpRelay(const TcpRelay&) = delete;
  TcpRelay& operator=(const TcpRelay&) = delete;

  [[nodiscard]] std::uint16_t port() const { return port_; }
  /// As LinkSchedule::cut(): announced before it begins. Holds for all that is sent after this has returned.
  void cut(const LinkCut& cut);

 private:
  struct Segment {
    std::vector<std::byte> bytes;  ///< none: the sender has ended
    std::size_t written = 0;
    std::int64_t there_ns = 0;
  };
  /// One way of a connection.
  struct Way {
    LinkSchedule schedule;
    std::deque<Segment> segments;
    std::size_t bytes = 0;  ///< of the segments
    bool ended = false;     ///< the sender has; no more is read
    bool done = false;      ///< the receiver was told
  };
  struct Connection {
    bus::FileDescriptor client, server;  ///< the server's is open from open_ns on
    std::int64_t open_ns = 0;
    Way up, down;
  };

  void run(const std::stop_token& stop);
  void accept_all(std::int64_t now_ns);
  /// Whether the connection goes on.
  [[nodiscard]] bool serve(Connection& connection, std::int64_t now_ns);
  /// Takes what the sender has, and gives the receiver what is there. False when one of them is broken.
  [[nodiscard]] static bool read_all(Way& way, int from, std::int64_t now_ns);
  [[nodiscard]] static bool write_due(Way& way, int to, std::int64_t now_ns);
  void wait(std::int64_t now_ns);

  const std::uint16_t to_port_;
  const LinkShape shape_;
  std::uint64_t seed_;
  bus::FileDescriptor listener_, wake_;
  std::uint16_t port_ = 0;
  std::vector<std::unique_ptr<Connection>> connections_;  ///< the thread's own
  std::mutex mutex_;
  std::condition_variable cut_known_;
  LinkCut cut_;
  bool cut_is_new_ = false;
  std::jthread thread_;
};

}  // namespace splatbus::cli
