#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "bus/clock.h"
#include "topic_statistics.h"

namespace splatbus::cli {

/// The longest wait for one message before a verb looks whether it shall stop.
inline constexpr std::chrono::milliseconds kPatience(50);

struct TopicOptions {
  std::string bus;
  std::vector<std::string> topics{"*"};
  double seconds = 0;
  std::uint64_t count = 0;
  bool json = false, once = false, csv = false;
  std::vector<std::string> fields;
  std::string filter;
};

/// Whether the topics that were asked for, names or prefixes with a *, include this one.
[[nodiscard]] bool is_asked_for(const TopicOptions& options, const std::string& topic);

/// Says on stderr which of those that were asked for there are not among `there`, and what may be meant.
void name_absent(const char* verb, const TopicOptions& options, const std::vector<std::string>& there);

/// A deadline that 0 seconds means never.
class Deadline {
 public:
  explicit Deadline(double seconds)
      : end_ns_(seconds > 0 ? bus::now_ns() + static_cast<std::int64_t>(seconds * 1e9) : 0) {}
  [[nodiscard]] bool passed() const { return end_ns_ != 0 && bus::now_ns() >= end_ns_; }

 private:
  std::int64_t end_ns_;
};

/// A line, at once: another program may read it.
void print(const std::string& text);

/// Follows sys/topics for as long as the options say: `each(before, after)` for each one and the one before it. Returns
/// the first and the last. No message of another topic comes here.
std::pair<TopicSnapshot, TopicSnapshot> follow_topics(
    const TopicOptions& options, const std::function<void(const TopicSnapshot&, const TopicSnapshot&)>& each);

/// The first sys/topics, which the broker holds for those who come. Throws std::runtime_error when none comes.
[[nodiscard]] TopicSnapshot topics_now(const std::string& bus);

}  // namespace splatbus::cli
