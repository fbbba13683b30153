#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <vector>

#include "gaussians/camera.h"
#include "stream/replica.h"
#include "stream/stream_model.h"
#include "streamer/endpoint.h"

namespace splatbus::streamer {

/// The last broadcast packets, for viewers that lag or lost some. Bounded in bytes.
class PacketHistory {
 public:
  explicit PacketHistory(std::size_t max_bytes) : max_bytes_(max_bytes) {}

  /// With any other number than the next one the history begins anew: what is kept has no gaps.
  void add(SharedPacket packet) {
    if (!packets_.empty() && packet->sequence() != packets_.back()->sequence() + 1) clear();
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
  /// Sequence of the newest; 0 when there is none.
  [[nodiscard]] std::uint64_t last() const { return packets_.empty() ? 0 : packets_.back()->sequence(); }
  [[nodiscard]] std::size_t bytes() const { return bytes_; }

 private:
  std::size_t max_bytes_, bytes_ = 0;
  std::deque<SharedPacket> packets_;
};

/// A snapshot's packets, shared by all that are sent it.
struct SnapshotPackets {
  std::uint64_t as_of = 0;
  std::vector<SharedPacket> head, chunks, tail;
};

/// Where a viewer is in the stream. It begins by waiting for a snapshot.
struct StreamCursor {
  bool waits_for_snapshot = true;
  std::shared_ptr<const SnapshotPackets> snapshot;  ///< being sent
  std::vector<SharedPacket> queue;                  ///< of the snapshot, in this viewer's order
  std::size_t queue_at = 0;
  std::optional<std::int64_t> snapshot_ns;  ///< when the last one began
  std::uint64_t next = 0;                   ///< broadcast packet
  std::deque<stream::MissingPackets> resend;
};

/// Which packet comes next at a cursor: what is to be resent, then the chunks of a snapshot, then the broadcast packets
/// that follow it. Places hold numbers and shared packets, so that they cost next to nothing. One thread.
class PacketFeed {
 public:
  static constexpr std::int64_t kSnapshotEveryNs = 2'000'000'000;

  PacketFeed(stream::StreamModel& model, std::size_t history_bytes) : model_(model), history_(history_bytes) {}

  /// After a tick of the model.
  void add(const std::vector<stream::EncodedPacket>& packets);
  /// After the model was reset: every cursor has to start over.
  void clear();

  static void start_over(StreamCursor& cursor);
  /// Goes on where a viewer that holds packets up to `holds` of `epoch` has been; false when it has to start over.
  [[nodiscard]] bool resume(StreamCursor& cursor, std::uint64_t epoch, std::uint64_t holds);
  /// Asks for broadcast packets again; those that are gone make the cursor start over.
  void resend(StreamCursor& cursor, std::uint64_t first, std::uint64_t last);

  /// What is to be sent next; null when there is nothing. A cursor that has lagged behind what is kept gets a snapshot
  /// in the order that suits `camera`: `lagged` is then set. Whatever it asks for, snapshots of one cursor begin at
  /// least kSnapshotEveryNs apart.
  /// `settled`: the model is not being ticked meanwhile; else no snapshot begins.
  [[nodiscard]] SharedPacket next(StreamCursor& cursor, const std::optional<Camera>& camera, std::int64_t now_ns,
                                  bool settled, bool& lagged);
  /// What next() gave was sent.
  static void advance(StreamCursor& cursor);

  [[nodiscard]] std::uint64_t snapshots() const { return snapshots_; }
  [[nodiscard]] std::uint64_t resends() const { return resends_; }

 private:
  bool begin_snapshot(StreamCursor& cursor, const std::optional<Camera>& camera, std::int64_t now_ns);
  [[nodiscard]] std::shared_ptr<const SnapshotPackets> current_snapshot();

  stream::StreamModel& model_;
  PacketHistory history_;
  std::shared_ptr<const SnapshotPackets> snapshot_;
  std::uint64_t snapshots_ = 0, resends_ = 0;
};

}  // namespace splatbus::streamer
