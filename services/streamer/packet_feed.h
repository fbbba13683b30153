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
#include "streamer/packet_history.h"

namespace splatbus::streamer {

/// A snapshot's packets, shared by all that are sent it.
struct SnapshotPackets {
  std::uint64_t as_of = 0;
  std::vector<SharedPacket> head, chunks, tail;
};

/// A viewer's place in the stream. It begins by waiting for a snapshot.
struct FeedPlace {
  bool waits_for_snapshot = true;
  std::shared_ptr<const SnapshotPackets> snapshot;  ///< being sent
  std::vector<SharedPacket> queue;                  ///< of the snapshot, in this viewer's order
  std::size_t queue_at = 0;
  std::uint64_t next = 0;  ///< broadcast packet
  std::deque<stream::MissingPackets> resend;
};

/// Which packet comes next at a place: what is to be resent, then the chunks of a snapshot, then the broadcast packets
/// that follow it. Places hold numbers and shared packets, so that they cost next to nothing. One thread.
class PacketFeed {
 public:
  PacketFeed(stream::StreamModel& model, std::size_t history_bytes) : model_(model), history_(history_bytes) {}

  /// After a tick of the model.
  void add(const std::vector<stream::EncodedPacket>& packets);
  /// After the model jumped: every place has to start over.
  void clear();

  static void start_over(FeedPlace& place);
  /// Goes on where a viewer that holds packets up to `holds` of `epoch` has been; false when it has to start over.
  [[nodiscard]] bool resume(FeedPlace& place, std::uint64_t epoch, std::uint64_t holds);
  /// Asks for broadcast packets again; those that are gone make the place start over.
  void resend(FeedPlace& place, std::uint64_t first, std::uint64_t last);

  /// What is to be sent next; null when there is nothing. A place that has lagged behind what is kept gets a snapshot
  /// in the order that suits `camera`: *lagged is then set.
  [[nodiscard]] SharedPacket next(FeedPlace& place, const std::optional<Camera>& camera, bool& lagged);
  /// What next() gave was sent.
  static void advance(FeedPlace& place);

  [[nodiscard]] std::uint64_t snapshots() const { return snapshots_; }
  [[nodiscard]] std::uint64_t resends() const { return resends_; }

 private:
  void begin_snapshot(FeedPlace& place, const std::optional<Camera>& camera);
  [[nodiscard]] std::shared_ptr<const SnapshotPackets> current_snapshot();

  stream::StreamModel& model_;
  PacketHistory history_;
  std::shared_ptr<const SnapshotPackets> snapshot_;
  std::uint64_t snapshots_ = 0, resends_ = 0;
};

}  // namespace splatbus::streamer
