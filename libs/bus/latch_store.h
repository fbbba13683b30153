#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "bus/frames.h"

namespace splatbus::bus {

/// The last message of each (topic, latch key), bounded: beyond the bounds those that were put longest ago leave.
class LatchStore {
 public:
  LatchStore(std::size_t max_messages, std::size_t max_bytes) : max_messages_(max_messages), max_bytes_(max_bytes) {}

  struct Held {
    std::uint64_t order = 0;  ///< as given to put()
    std::int64_t stamp = 0;   ///< of the caller's own
    Frames frames;
  };

  /// `order` grows from call to call. Returns how many other messages had to leave.
  std::size_t put(const std::string& topic, const std::string& key, std::uint64_t order, Frames frames,
                  std::int64_t stamp = 0);
  [[nodiscard]] Held* find(const std::string& topic, const std::string& key);
  void erase(const std::string& topic, const std::string& key);

  /// Messages whose topic begins with `prefix`, oldest first; sharing their bytes.
  [[nodiscard]] std::vector<Held> matching(std::string_view prefix);

  [[nodiscard]] std::size_t size() const { return held_.size(); }
  [[nodiscard]] std::size_t bytes() const { return bytes_; }

 private:
  using Key = std::pair<std::string, std::string>;
  std::size_t evict();

  const std::size_t max_messages_;
  const std::size_t max_bytes_;
  std::size_t bytes_ = 0;
  std::map<Key, Held> held_;
  std::map<std::uint64_t, Key> by_order_;
};

}  // namespace splatbus::bus
