#pragma once

#include <cstdint>
#include <deque>

#include "streamer/endpoint.h"

namespace splatbus::streamer {

/// The last broadcast packets, for viewers that lag or lost some. Bounded in bytes.
class PacketHistory {
 public:
  explicit PacketHistory(std::size_t max_bytes) : max_bytes_(max_bytes) {}

  /// `packet` has the next sequence number; after a jump (clear) any.
  void add(SharedPacket packet) {
    bytes_ += packet->bytes();
    packets_.push_back(std::move(packet));
    while (packets_.size() > 1 && bytes_ > max_bytes_) {
      bytes_ -= packets_.front()->bytes();
      packets_.pop_front();
    }
  }
  void clear() {
    packets_.clear();
    bytes_ = 0;
  }

  /// Null when it is not (or no longer) here.
  [[nodiscard]] SharedPacket find(std::uint64_t sequence) const {
    if (packets_.empty() || sequence < packets_.front()->sequence() || sequence > packets_.back()->sequence())
      return {};
    return packets_[sequence - packets_.front()->sequence()];
  }
  [[nodiscard]] std::size_t bytes() const { return bytes_; }

 private:
  std::size_t max_bytes_, bytes_ = 0;
  std::deque<SharedPacket> packets_;
};

}  // namespace splatbus::streamer
