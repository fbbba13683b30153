#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <set>
#include <string>
#include <thread>
#include <zmq.hpp>

#include "bus/broker.h"
#include "bus/file_descriptor.h"
#include "bus/frames.h"
#include "bus/inliner.h"
#include "bus/latch_store.h"
#include "bus/liveness.h"
#include "bus/log_sink.h"
#include "bus/own_messages.h"

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
  };
  void bind_tcp(const BrokerOptions& options);
  void run(const std::stop_token& stop);
  void relay_from(Side& side);
  void relay(const bus::Frames& frames, bool local);
  bool hold(const bus::Frames& frames, const wire::Header& header, bool local);
  void warn_of_namesakes(const std::string& topic, const wire::Header& header, const wire::Header& known);
  void send(Side& side, const bus::Frames& frames, const wire::Header& header);
  void send_inlined(const bus::Frames& frames);
  void read_subscriptions(Side& side);
  void resend_held(Side& side, const std::string& prefix);
  void tick();
  void refuse(const bus::Frames& frames, const std::string& why);

  const FindSlab find_slab_;
  const std::function<std::size_t()> count_slabs_;
  zmq::context_t zmq_;
  Side local_;
  Side remote_;
  std::uint16_t tcp_port_ = 0;
  bus::LatchStore held_;
  std::uint64_t next_order_ = 1;
  std::set<std::string> remote_prefixes_;
  Liveness liveness_;
  TopicTable topics_;
  OwnMessages own_;
  std::int64_t next_beat_ns_ = 0;
  std::int64_t next_report_ns_ = 0;
  bus::LogLimiter limiter_;
  std::atomic<std::uint64_t> relayed_ = 0;
  std::atomic<std::uint64_t> malformed_ = 0;
  std::atomic<std::uint64_t> inlined_ = 0;
  std::atomic<std::uint64_t> inline_dropped_ = 0;
  std::atomic<std::uint64_t> held_count_ = 0;
  bus::FileDescriptor wake_;
  std::jthread thread_;
};

}  // namespace splatbus::bus_service
