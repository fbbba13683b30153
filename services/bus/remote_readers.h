#pragma once

#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <thread>
#include <utility>
#include <vector>

#include "bus/counted_frames.h"
#include "bus/file_descriptor.h"
#include "bus/frames.h"
#include "bus/inliner.h"
#include "bus/token_bucket.h"

namespace splatbus::bus_service {

/// What readers over tcp get, and what it may cost: copies of slabs' bytes for them, made by a thread of its own. What
/// ZeroMQ has not sent yet is counted; beyond the bound a message is not copied but left out, for readers that take
/// nothing must not fill the memory. Called by one thread.
class RemoteReaders {
 public:
  RemoteReaders(FindSlab find_slab, std::size_t max_bytes);
  ~RemoteReaders();
  RemoteReaders(const RemoteReaders&) = delete;
  RemoteReaders& operator=(const RemoteReaders&) = delete;

  using Prefixes = std::set<std::string, std::less<>>;
  /// What is held of these topics is to be sent again.
  void ask_for_held(const std::string& prefix);
  /// What was asked for since the last time, when what is held may be sent again; empty before that.
  [[nodiscard]] Prefixes take_due(std::int64_t now_ns);
  [[nodiscard]] bool has_due() const { return !due_.empty(); }

  /// What becomes of a message.
  struct Offered {
    std::optional<bus::Frames> now{};  ///< as it is to be sent at once
    bool left_out = false;             ///< there is no room; where both are not, it comes back by take()
  };
  [[nodiscard]] Offered offer(const bus::Frames& frames, const wire::Header& header);

  struct Done {
    bus::Frames frames;
    bool complete = false;  ///< false: its slab is gone, or its slot was written again
    std::string error;      ///< why it makes no sense
    bool inlined = false;
  };
  /// Those that are ready, in the order of each topic.
  [[nodiscard]] std::vector<Done> take();
  [[nodiscard]] int ready_fd() const { return ready_.get(); }

  /// Topics of what was left out since the last time because readers had too much unread, some of them.
  [[nodiscard]] std::set<std::string> take_unserved() { return std::exchange(unserved_, {}); }

 private:
  struct Job {
    bus::Frames frames;
    std::size_t bytes = 0;  ///< of slabs
  };
  void run(const std::stop_token& stop);
  Done work(const Job& job);

  const FindSlab find_slab_;
  const UnsentBytes unsent_;
  Prefixes due_;
  bus::TokenBucket resends_;
  std::set<std::string> unserved_;

  std::mutex mutex_;  // of all below
  std::condition_variable_any given_;
  std::deque<Job> jobs_;
  std::deque<Done> done_;
  std::size_t job_bytes_ = 0;                               // of jobs_, and of the one that is worked on
  std::map<std::string, std::size_t, std::less<>> topics_;  // messages that are not taken yet
  bus::FileDescriptor ready_;
  std::jthread thread_;
};

}  // namespace splatbus::bus_service
