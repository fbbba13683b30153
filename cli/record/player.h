#pragma once

#include <condition_variable>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <stop_token>
#include <string>
#include <utility>
#include <vector>

#include "bus/publisher.h"
#include "bus/tensor_ring.h"
#include "mcap/reader.h"
#include "recorded_message.h"

namespace splatbus::cli {

struct PlayOptions {
  double rate = 1;                       ///< recorded seconds a second
  bool loop = false;                     ///< again and again
  double start_s = 0;                    ///< from the recording's beginning; what was latched by then comes first
  double duration_s = 0;                 ///< recorded seconds; 0: to the end
  std::vector<std::string> topics{"*"};  ///< recorded names; one that ends in * is a prefix
  std::vector<std::string> exclude;
  std::vector<std::string> sources;          ///< what these processes published; empty: all
  std::set<std::string> silent;              ///< sources that are not played
  std::map<std::string, std::string> remap;  ///< topic for a recorded topic
  bool recorded_clock = false;               ///< times and scene versions as recorded
  /// Called in the player's thread before what was logged at that time is played; all that follows is later by as long
  /// as it takes.
  std::function<void(std::uint64_t log_time, const std::stop_token& stop)> hold = {};
};

/// What has been played, and what has not and why.
struct PlayState {
  std::uint64_t messages = 0, bytes = 0, loops = 0;
  double position_s = 0;                         ///< in the recording
  std::int64_t late_ns = 0;                      ///< the most that a message was behind its time
  std::map<std::string, std::uint64_t> sources;  ///< messages played of each
  std::uint64_t without_tensors = 0;             ///< not played: their tensors were not recorded
  std::uint64_t unreadable = 0;                  ///< not played: damaged, or no messages of the bus
  std::string first_problem;                     ///< of the latter
  bool paused = false;
};

/// Publishes a recording on a bus. Each recorded source speaks through a connection of its own under its name, tensors
/// lie in slabs of that connection, and headers say this machine's epoch, sequence and times, so that a reader cannot
/// tell it from the processes that were recorded. One thread, but for toggle_pause() and step().
class Player {
 public:
  /// `reader` stays.
  Player(mcap::Reader& reader, bus::Address address, PlayOptions options);

  /// Pauses, or goes on where it paused.
  void toggle_pause();
  /// While it pauses: plays the next message. Going on, those behind it keep their distance from it.
  void step();

  /// Returns at the end, and when `stop` is asked for. `each_second(state)`, and when it pauses, steps or goes on.
  /// Throws std::runtime_error when a slab cannot be made.
  PlayState run(const std::stop_token& stop, const std::function<void(const PlayState&)>& each_second);

 private:
  struct Speaker {
    std::unique_ptr<bus::Publisher> publisher;
    std::map<std::pair<std::string, std::string>, bus::TensorRing> rings;  ///< by topic and key of what is latched
  };
  void play_once(const std::stop_token& stop);
  void say_latched(std::uint64_t before);
  [[nodiscard]] bool is_wanted(const mcap::Channel& channel) const;
  void take(const mcap::Channel& channel, std::span<const std::byte> data);
  void publish(const mcap::Channel& channel, RecordedMessage& message);
  [[nodiscard]] std::vector<bus::OutgoingTensor> place(Speaker& speaker, const std::string& topic,
                                                       const RecordedMessage& message);
  Speaker& speaker_of(const std::string& source);
  [[nodiscard]] std::int64_t due_ns(std::uint64_t log_time) const;
  /// True when it was not waited for, but stepped to.
  bool wait_until(std::int64_t time_ns, const std::stop_token& stop);
  void report(std::int64_t now_ns);
  void hold(std::uint64_t log_time, const std::stop_token& stop);
  void note(const std::string& problem);

  mcap::Reader& reader_;
  const bus::Address address_;
  const PlayOptions options_;
  std::int64_t realtime_minus_monotonic_ns_ = 0;  ///< when it was recorded
  bool knows_clock_ = false;
  std::map<std::string, std::size_t> largest_;  ///< bytes of a message's tensors, by topic
  std::map<std::string, Speaker> speakers_;
  std::size_t rings_ = 0;
  std::int64_t begin_ns_ = 0;  ///< of this loop
  std::int64_t held_ns_ = 0;   ///< in it, by PlayOptions::hold and by pauses; less what steps went ahead
  std::uint64_t begin_log_time_ = 0, end_log_time_ = 0;
  PlayState state_;
  std::function<void(const PlayState&)> each_second_;
  std::int64_t next_second_ns_ = 0;
  std::mutex mutex_;
  std::condition_variable_any changed_;
  bool paused_ = false;      ///< these two are others' to change
  std::uint64_t steps_ = 0;  ///< that are still to be taken
};

}  // namespace splatbus::cli
