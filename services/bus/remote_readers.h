#pragma once

#include <atomic>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "bus/file_descriptor.h"
#include "bus/frames.h"
#include "bus/inliner.h"
#include "bus/token_bucket.h"

namespace splatbus::bus_service {

/// What readers over tcp get, and what it may cost: which topics they want, and the copies of slabs' bytes for them,
/// made by a thread of its own. The copies that ZeroMQ has not sent yet are counted; beyond the bound a message is not
/// copied but left out, for readers that take nothing must not fill the memory. Called by one thread.
class RemoteReaders {
 public:
  RemoteReaders(FindSlab find_slab, std::size_t max_bytes);
  ~RemoteReaders();
  RemoteReaders(const RemoteReaders&) = delete;
  RemoteReaders& operator=(const RemoteReaders&) = delete;

  void subscribe(const std::string& prefix);
  void unsubscribe(const std::string& prefix);
  [[nodiscard]] bool wants(std::string_view topic) const;

  /// The prefixes that were subscribed to since the last time, when what is held may be sent again; empty before that.
  [[nodiscard]] std::set<std::string> take_due(std::int64_t now_ns);
  [[nodiscard]] bool has_due() const { return !due_.empty(); }

  /// True when the message is to be sent as it is, now. Else it comes back by take(), or is left out and counted.
  [[nodiscard]] bool offer(const bus::Frames& frames, const wire::Header& header);

  struct Done {
    bus::Frames frames;
    bool complete = false;  ///< false: its slab is gone, or its slot was written again
    std::string error;      ///< why it makes no sense
    bool inlined = false;
  };
  /// Those that are ready, in the order of each topic.
  [[nodiscard]] std::vector<Done> take();
  [[nodiscard]] int ready_fd() const { return ready_.get(); }

  [[nodiscard]] std::uint64_t left_out() const { return left_out_; }

 private:
  struct Job {
    bus::Frames frames;
    std::size_t bytes = 0;  ///< of slabs
  };
  void run(const std::stop_token& stop);
  Done work(const Job& job);

  const FindSlab find_slab_;
  const std::size_t max_bytes_;
  std::set<std::string> prefixes_, due_;
  bus::TokenBucket resends_;
  std::shared_ptr<std::atomic<std::size_t>> unsent_;  ///< bytes of copies that are there
  std::uint64_t left_out_ = 0;

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
