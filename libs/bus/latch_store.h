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
/// leaves, of the source itself, or of that which holds the most. All sources that are far together have no more than
/// one, and give way before any that is near: they may be as many as one peer likes.
class LatchStore {
 public:
  /// `share` of both bounds is what one source may hold.
  LatchStore(std::size_t max_messages, std::size_t max_bytes, double share = 1);

  struct Held {
    std::uint64_t order = 0;  ///< as given to put()
    std::int64_t stamp = 0;   ///< of the caller's own
    Frames frames;
    std::string source = {};
    bool far = false;
  };

  struct Put {
    /// False when the message alone is too large, or was what had to leave; what was held before is gone then too.
    bool held = false;
    std::size_t evicted = 0;  ///< other messages that had to leave
  };
  /// `order` grows from call to call.
  Put put(const std::string& topic, const std::string& key, const std::string& source, std::uint64_t order,
          Frames frames, std::int64_t stamp = 0, bool far = false);
  [[nodiscard]] Held* find(const std::string& topic, const std::string& key);
  void erase(const std::string& topic, const std::string& key);

  /// Messages whose topic begins with `prefix`, oldest first; sharing their bytes.
  [[nodiscard]] std::vector<Held> matching(std::string_view prefix);

  [[nodiscard]] std::size_t size() const { return held_.size(); }
  [[nodiscard]] std::size_t bytes() const { return bytes_; }

 private:
  using Key = std::pair<std::string, std::string>;
  using Source = std::pair<bool, std::string>;  ///< whether it is far
  struct Share {
    std::size_t bytes = 0;
    std::map<std::uint64_t, Key> by_order;
  };
  using Shares = std::map<Source, Share>;
  struct Sum {
    std::size_t messages = 0, bytes = 0;
  };
  void erase_oldest(const Source& source);
  /// The one among those, of which there is one, that holds the most.
  static Source largest(Shares::const_iterator begin, Shares::const_iterator end, bool by_bytes);

  const std::size_t max_messages_, max_bytes_;
  const std::size_t max_messages_of_one_, max_bytes_of_one_;
  std::size_t bytes_ = 0;
  Sum far_;  ///< of held_
  std::map<Key, Held> held_;
  Shares sources_;
};

}  // namespace splatbus::bus
