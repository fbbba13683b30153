#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <thread>
#include <zmq.hpp>

#include "bus/address.h"
#include "bus/curve.h"
#include "bus/file_descriptor.h"
#include "bus/frames.h"
#include "bus/latch_store.h"
#include "bus/slab_client.h"

namespace splatbus::bus {

/// The one publishing socket of a Context, shared by its Publishers under a mutex. It is an XPUB, so that it sees the
/// broker's subscription: that is the sign that the broker is there, or is there again. What was published before then
/// waits here, bounded, and each new connection is first told every latched message again: once the broker has the
/// slabs that they point into, or has not taken them for a second.
///
/// Never logs: the log itself is published through it.
class Outbox {
 public:
  /// `slabs`: of this process, which outlive this; null where there are none.
  Outbox(zmq::context_t& context, const Address& address, const std::optional<ClientKeys>& keys, SlabClient* slabs);
  ~Outbox();
  Outbox(const Outbox&) = delete;
  Outbox& operator=(const Outbox&) = delete;

  /// Numbers the message within its topic (Header.sequence, in place), sends it, and returns the number. `latch_key` is
  /// null for what is not latched.
  std::uint64_t send(Frames frames, const std::string* latch_key);

  [[nodiscard]] bool wait_connected(std::chrono::milliseconds timeout);

  /// Lets the connection go, once the broker has what was sent, and with it the name. What is sent later goes nowhere.
  void close();

 private:
  struct Pending {
    std::uint64_t order;
    Frames frames;
  };
  std::uint64_t& sequence_of(std::string_view topic);
  void run(const std::stop_token& stop);
  void read_subscriptions();
  void read_subscriptions_if_due();
  void greet();
  void catch_up();

  SlabClient* const slabs_;
  std::mutex mutex_;
  std::condition_variable connected_changed_;
  zmq::socket_t socket_;
  bool reached_ = false;    ///< by a broker's subscription
  bool connected_ = false;  ///< and it has been told what it had to be
  bool closed_ = false;
  std::int64_t reached_ns_ = 0;
  std::int64_t read_ns_ = 0;  ///< when subscriptions were last read
  std::uint64_t next_order_ = 1;
  std::map<std::string, std::uint64_t, std::less<>> sequences_;  ///< by topic
  LatchStore latched_;
  std::deque<Pending> pending_;
  std::size_t pending_bytes_ = 0;
  bool waiting_ = false;  ///< something was published that no broker has seen
  FileDescriptor wake_;
  std::jthread thread_;
};

}  // namespace splatbus::bus
