#pragma once

#include <sys/stat.h>

#include <cstdint>
#include <string>

namespace splatbus::bus {

/// Makes sure that a bus's folder is this user's alone: makes it with mode 0700 when it is missing, and closes it to
/// others when it is empty or a bus's already. Whoever connects makes it as whoever binds does: in a folder like /tmp
/// the first who makes it owns it. Throws Error naming the folder: it cannot be made, is another user's, is open to
/// others, or is no folder (a link).
void require_private_folder(const std::string& folder);

enum class EndpointUse : std::uint8_t { Connect, Bind };

/// Makes sure that only this user can be at the other end of an ipc endpoint: its folder, which is made with mode 0700
/// when it is missing, is this user's, nobody else may write to it (a group that is named by this user's own number is
/// nobody else), and what is at the path already is this user's too. In a folder like /tmp, where nobody can move what
/// is another's, that has to be there to connect to. Throws Error naming the endpoint. Of other transports it knows
/// nothing.
void require_own_endpoint(const std::string& endpoint, EndpointUse use = EndpointUse::Connect);

/// libzmq's ZMQ_IPC_FILTER_UID, which its header does not always name: a socket that is bound over ipc afterwards takes
/// that user's connections and no others.
inline constexpr int kIpcFilterUid = 59;

/// Throws Error when the process at the other end of a connected Unix socket is another user's.
void require_own_peer(int socket, const std::string& what);

/// While it lives, new files and sockets are their owner's alone. Of the whole process: for start-up.
class PrivateUmask {
 public:
  PrivateUmask() : before_(::umask(0077)) {}
  ~PrivateUmask() { ::umask(before_); }
  PrivateUmask(const PrivateUmask&) = delete;
  PrivateUmask& operator=(const PrivateUmask&) = delete;

 private:
  mode_t before_;
};

}  // namespace splatbus::bus
