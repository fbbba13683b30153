#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <stdexcept>
#include <string>
#include <vector>

#include "bus/clock.h"

namespace splatbus::bench {

inline constexpr std::size_t kSamples = 1 << 20;
inline constexpr const char* kOurs = "splatbus, broker";
inline constexpr std::chrono::milliseconds kPatience(100);

/// Of one run, in memory that all its processes share.
struct Shared {
  std::atomic<bool> reads, stop;
  std::atomic<std::uint64_t> sent, received;
  std::atomic<std::int64_t> first_ns, last_ns;
  std::array<std::int32_t, kSamples> latency_ns;

  void take(std::int64_t sent_ns) {
    const std::int64_t now = bus::now_ns();
    const std::uint64_t index = received.load(std::memory_order_relaxed);
    latency_ns[index % kSamples] = static_cast<std::int32_t>(std::min<std::int64_t>(now - sent_ns, INT32_MAX));
    if (index == 0) first_ns = now;
    last_ns = now;
    received.store(index + 1, std::memory_order_release);
  }
};

/// How messages get from one process to another: `prepare` in each process, then one call for each message.
struct Way {
  std::string name;
  std::function<std::function<void()>(const std::string& folder)> make_sender;
  std::function<void(const std::string& folder, Shared&)> read;
  std::function<void(const std::string& folder)> relay;  ///< empty: none between
};

/// ZeroMQ alone, one process to the other, with a proxy between or none; and the bus. All through sockets in a folder.
std::vector<Way> ways();
/// Publishes that many bytes of which the first are the time, to who has subscribed; blocks until there is one.
std::function<void()> zmq_sender(const std::string& folder, bool through_proxy, std::size_t bytes);
void zmq_read(const std::string& folder, Shared& shared);
void bus_relay(const std::string& folder);
/// Throws std::runtime_error after two minutes.
void wait_for(const std::function<bool()>& condition);

/// Temporary, with all that is in it.
class Folder {
 public:
  Folder() {
    std::string name = (std::filesystem::temp_directory_path() / "splatbus-bench-XXXXXX").string();
    if (::mkdtemp(name.data()) == nullptr) throw std::runtime_error("mkdtemp");
    path_ = name;
  }
  ~Folder() { std::filesystem::remove_all(path_); }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;
  [[nodiscard]] const std::string& path() const { return path_; }

 private:
  std::string path_;
};

}  // namespace splatbus::bench
