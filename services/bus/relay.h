#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <thread>
#include <utility>
#include <zmq.hpp>

#include "bus/broker.h"
#include "bus/connection_guard.h"
#include "bus/counted_frames.h"
#include "bus/curve.h"
#include "bus/file_descriptor.h"
#include "bus/frames.h"
#include "bus/latch_store.h"
#include "bus/liveness.h"
#include "bus/local_readers.h"
#include "bus/log_sink.h"
#include "bus/own_messages.h"
#include "bus/remote_readers.h"
#include "bus/remote_subscriptions.h"
#include "bus/socket_waits.h"
#include "bus/sources.h"

namespace splatbus::bus_service {

/// The broker's message side: XSUB to XPUB, for this machine and over tcp, with the held messages and the liveness of
/// sources. One thread.
class Relay {
 public:
  /// Binds. Throws bus::Error.
  Relay(const BrokerOptions& options, FindSlab find_slab, std::function<std::size_t()> count_slabs);
  ~Relay();
  Relay(const Relay&) = delete;
  Relay& operator=(const Relay&) = delete;

  [[nodiscard]] std::uint16_t tcp_port() const { return tcp_port_; }
  [[nodiscard]] BrokerStatistics statistics() const;

 private:
  /// The pair of sockets for one kind of reach.
  struct Side {
    bool local;
    zmq::socket_t xsub;
    zmq::socket_t xpub;
    std::size_t xsub_wait = 0, xpub_wait = 0;                ///< in waits_
    std::set<std::pair<std::string, std::string>> missed{};  ///< topics and keys of what is held and was left out
  };
  // relay_sockets.cpp
  void set_up_sockets(const BrokerOptions& options);
  void bind_tcp(const BrokerOptions& options);
  void guard_tcp(const BrokerOptions& options);

  void run(const std::stop_token& stop);
  void relay_from(Side& side);
  /// What a peer sent: refused, or relayed.
  void take(bus::Frames& frames, bool local);
  void relay(const bus::Frames& frames, const wire::Header& header, std::int64_t now, bool local);
  void relay_own(const bus::Frames& frames);
  bool hold(const bus::Frames& frames, const wire::Header& header, bool local);
  bool is_stale(const wire::Header& header, const bus::LatchStore::Held& held, bool local) const;
  void send_inlined();
  void read_subscriptions(Side& side);
  std::set<std::string> readers_of(const std::string& topic) const;
  void resend_held(Side& side, const std::string& prefix);
  void resend_due();
  void tick();
  void refuse(const bus::Frames& frames, const std::string& why);

  // relay_room.cpp
  void send(Side& side, const bus::Frames& frames, const wire::Header& header);
  /// False: there is no room for it.
  bool send_now(Side& side, const bus::Frames& frames, const wire::Header& header);
  void send_on(Side& side, bus::Frames frames);
  void resend_missed(Side& side);
  void make_room(std::int64_t now);

  const std::function<std::size_t()> count_slabs_;
  zmq::context_t zmq_;
  std::shared_ptr<bus::AllowList> allowed_;  ///< null where nobody needs a key
  std::optional<bus::Authenticator> authenticator_;
  Side local_;
  Side remote_;
  std::optional<bus::ConnectionGuard> writers_guard_, readers_guard_;  ///< of remote_
  std::uint16_t tcp_port_ = 0;
  bus::LatchStore held_;
  std::uint64_t next_order_ = 1;
  LocalReaders local_readers_;
  UnsentBytes unsent_here_;
  bool full_here_lately_ = false;
  RemoteSubscriptions subscriptions_;
  RemoteReaders remote_readers_;
  Sources sources_;
  Liveness liveness_;
  TopicTable topics_;
  OwnMessages own_;
  std::int64_t next_beat_ns_ = 0;
  std::int64_t next_report_ns_ = 0;
  bus::LogLimiter limiter_;
  std::atomic<std::uint64_t> relayed_ = 0;
  std::atomic<std::uint64_t> malformed_ = 0;
  std::atomic<std::uint64_t> inlined_ = 0;
  std::atomic<std::uint64_t> overwritten_ = 0, left_out_ = 0;
  std::atomic<std::uint64_t> unheld_ = 0;
  std::atomic<std::uint64_t> held_count_ = 0;
  bus::FileDescriptor wake_;
  SocketWaits waits_;
  std::jthread thread_;
};

}  // namespace splatbus::bus_service
