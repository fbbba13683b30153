#pragma once

#include <filesystem>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <stdexcept>
#include <string>

#include "bus/address.h"
#include "bus/file_descriptor.h"

namespace splatbus::cli {

/// Of the messages over the socket; a request names it.
inline constexpr int kControlVersion = 1;

/// Where the supervisor of a bus listens: in the bus's folder, or, for a bus over tcp, in this user's runtime folder.
struct ControlPaths {
  std::filesystem::path folder, socket, lock;
};
[[nodiscard]] ControlPaths control_paths(const bus::Address& bus);

/// There is a supervisor on the bus already.
class SupervisorRuns : public std::runtime_error {
 public:
  SupervisorRuns(const bus::Address& bus, pid_t pid);
  pid_t pid;
};

/// There is no supervisor on the bus.
class NoSupervisor : public std::runtime_error {
 public:
  explicit NoSupervisor(const bus::Address& bus);
};

/// There is a supervisor, and it says nothing: it was stopped by a signal, say.
class SupervisorSilent : public std::runtime_error {
 public:
  SupervisorSilent(pid_t pid, double silent_s);
};

/// The one place of a bus's supervisor: holds a lock on a file while it lives, so that what a dead one left behind is
/// known to be stale, and listens. Throws SupervisorRuns, or bus::Error.
class ControlListener {
 public:
  explicit ControlListener(const bus::Address& bus);
  ~ControlListener();
  ControlListener(const ControlListener&) = delete;
  ControlListener& operator=(const ControlListener&) = delete;

  [[nodiscard]] int fd() const { return listener_.get(); }
  /// False when somebody removed the folder or its files: nobody finds us any more.
  [[nodiscard]] bool intact() const;

 private:
  ControlPaths paths_;
  bus::FileDescriptor lock_, listener_;
};

/// JSON objects, one a line, over a connected Unix socket whose other end is this user's. One thread reads, one writes.
class LineSocket {
 public:
  /// Throws bus::Error when the other end is somebody else's.
  explicit LineSocket(bus::FileDescriptor socket);

  [[nodiscard]] int fd() const { return socket_.get(); }
  /// How long receive() waits for what comes next; at first, and with 0, as long as it takes.
  void set_patience(double seconds);
  /// The next object; nullopt at the end. Throws SupervisorSilent when nothing comes for too long, and
  /// std::runtime_error on what is not a JSON object, or is too long.
  [[nodiscard]] std::optional<nlohmann::json> receive();
  /// False when nobody reads any more, or too slowly.
  bool send(const nlohmann::json& object);
  bool send_line(std::string line);  ///< of an object, without the end

 private:
  bus::FileDescriptor socket_;
  std::string buffer_;
  double patience_s_ = 0;
};

/// A connection to the supervisor of a bus. Throws NoSupervisor, SupervisorSilent where so many wait for an answer that
/// there is no room for one more, or bus::Error when it is another user's.
[[nodiscard]] LineSocket connect_control(const bus::Address& bus);

}  // namespace splatbus::cli
