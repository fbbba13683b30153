#include "streamer/packet_feed.h"

#include <algorithm>

namespace splatbus::streamer {

namespace {

constexpr std::size_t kMaxResends = 64;
constexpr std::uint64_t kMaxSnapshotAge = 256;  // broadcast packets; a newer one costs less than catching up on more

std::vector<SharedPacket> shared(const std::vector<stream::EncodedPacket>& packets) {
  std::vector<SharedPacket> out;
  out.reserve(packets.size());
  for (const auto& packet : packets) out.push_back(std::make_shared<WirePacket>(packet));
  return out;
}

}  // namespace

void PacketFeed::add(const std::vector<stream::EncodedPacket>& packets) {
  for (const auto& packet : packets) history_.add(std::make_shared<WirePacket>(packet));
}

void PacketFeed::clear() {
  history_.clear();
  snapshot_.reset();
}

void PacketFeed::start_over(StreamCursor& cursor) {
  cursor.waits_for_snapshot = true;
  cursor.snapshot.reset();
  cursor.queue.clear();
  cursor.queue_at = 0;
  cursor.resend.clear();
}

bool PacketFeed::resume(StreamCursor& cursor, std::uint64_t epoch, std::uint64_t holds) {
  const stream::StreamModel::Status held = model_.status();
  const bool kept = held.ready && epoch == held.epoch && holds > 0 &&
                    (holds == held.sequence || holds == history_.last() || history_.find(holds + 1));
  if (!kept) return false;
  cursor.waits_for_snapshot = false;
  cursor.next = holds + 1;
  return true;
}

void PacketFeed::resend(StreamCursor& cursor, std::uint64_t first, std::uint64_t last) {
  if (cursor.waits_for_snapshot || cursor.snapshot) return;
  last = std::min(last, model_.status().sequence);
  if (first == 0 || first > last) return;
  if (first >= cursor.next) return;  // on its way
  last = std::min(last, cursor.next - 1);
  ++resends_;
  if (!history_.find(first) || !history_.find(last)) return start_over(cursor);
  if (cursor.resend.size() < kMaxResends) cursor.resend.push_back({first, last});
}

std::shared_ptr<const SnapshotPackets> PacketFeed::current_snapshot() {
  const std::uint64_t now = model_.held().sequence;
  const bool usable = snapshot_ && now - snapshot_->as_of <= kMaxSnapshotAge &&
                      (snapshot_->as_of == now || history_.find(snapshot_->as_of + 1));
  if (!usable) {
    const stream::EncodedSnapshot encoded = model_.snapshot();
    snapshot_ = std::make_shared<SnapshotPackets>(
        SnapshotPackets{encoded.as_of, shared(encoded.head), shared(encoded.chunks), shared(encoded.tail)});
  }
  return snapshot_;
}

bool PacketFeed::begin_snapshot(StreamCursor& cursor, const std::optional<Camera>& camera, std::int64_t now_ns) {
  if (cursor.snapshot_ns && now_ns - *cursor.snapshot_ns < kSnapshotEveryNs) return false;
  cursor.snapshot_ns = now_ns;
  ++snapshots_;
  cursor.snapshot = current_snapshot();
  cursor.queue = cursor.snapshot->head;
  if (cursor.snapshot->as_of == model_.held().sequence) {
    for (const std::size_t chunk : model_.chunk_order(camera)) cursor.queue.push_back(cursor.snapshot->chunks[chunk]);
  } else {
    cursor.queue.insert(cursor.queue.end(), cursor.snapshot->chunks.begin(), cursor.snapshot->chunks.end());
  }
  cursor.queue.insert(cursor.queue.end(), cursor.snapshot->tail.begin(), cursor.snapshot->tail.end());
  cursor.queue_at = 0;
  cursor.next = cursor.snapshot->as_of + 1;
  cursor.waits_for_snapshot = false;
  return true;
}

SharedPacket PacketFeed::next(StreamCursor& cursor, const std::optional<Camera>& camera, std::int64_t now_ns,
                              bool settled, bool& lagged) {
  if (!model_.status().ready) return {};
  while (!cursor.resend.empty()) {
    if (SharedPacket packet = history_.find(cursor.resend.front().first)) return packet;
    start_over(cursor);
  }
  if (!cursor.waits_for_snapshot && !cursor.snapshot) {
    if (SharedPacket packet = history_.find(cursor.next)) return packet;
    if (history_.last() < cursor.next) return {};  // it is being made
    lagged = true;                                 // the history has moved on
    start_over(cursor);
  }
  if (cursor.waits_for_snapshot && (!settled || !begin_snapshot(cursor, camera, now_ns))) return {};
  return cursor.queue[cursor.queue_at];
}

void PacketFeed::advance(StreamCursor& cursor) {
  if (!cursor.resend.empty()) {
    if (++cursor.resend.front().first > cursor.resend.front().last) cursor.resend.pop_front();
  } else if (cursor.snapshot) {
    if (++cursor.queue_at == cursor.queue.size()) {
      cursor.snapshot.reset();
      cursor.queue.clear();
    }
  } else {
    ++cursor.next;
  }
}

}  // namespace splatbus::streamer
