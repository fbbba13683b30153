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

/// The last message of each (topic, latch key), bounded in all and a source: beyond the bounds what was put longest ago
/// leaves, of the source itself, or of that which holds the most.
class LatchStore {
 public:
  /// `share` of both bounds is what one source may hold.
  LatchStore(std::size_t max_messages, std::size_t max_bytes, double share = 1);

  struct Held {
    std::uint64_t order = 0;  ///< as given to put()
    std::int64_t stamp = 0;   ///< of the caller's own
    Frames frames;
    std::string source = {};
  };

  struct Put {
    bool held = false;        ///< false when the message alone is too large; what was held before is gone then too
    std::size_t evicted = 0;  ///< other messages that had to leave
  };
  /// `order` grows from call to call.
  Put put(const std::string& topic, const std::string& key, const std::string& source, std::uint64_t order,
          Frames frames, std::int64_t stamp = 0);
  [[nodiscard]] Held* find(const std::string& topic, const std::string& key);
  void erase(const std::string& topic, const std::string& key);

  /// Messages whose topic begins with `prefix`, oldest first; sharing their bytes.
  [[nodiscard]] std::vector<Held> matching(std::string_view prefix);

  [[nodiscard]] std::size_t size() const { return held_.size(); }
  [[nodiscard]] std::size_t bytes() const { return bytes_; }

 private:
  using Key = std::pair<std::string, std::string>;
  struct Share {
    std::size_t bytes = 0;
    std::map<std::uint64_t, Key> by_order;
  };
  void erase_oldest(const std::string& source);

  const std::size_t max_messages_, max_bytes_;
  const std::size_t max_messages_of_one_, max_bytes_of_one_;
  std::size_t bytes_ = 0;
  std::map<Key, Held> held_;
  std::map<std::string, Share> sources_;
};

}  // namespace splatbus::bus
