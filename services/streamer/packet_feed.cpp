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

void PacketFeed::start_over(FeedPlace& place) {
  place.waits_for_snapshot = true;
  place.snapshot.reset();
  place.queue.clear();
  place.queue_at = 0;
  place.resend.clear();
}

bool PacketFeed::resume(FeedPlace& place, std::uint64_t epoch, std::uint64_t holds) {
  const bool kept = model_.ready() && epoch == model_.held().epoch && holds > 0 &&
                    (holds == model_.held().sequence || history_.find(holds + 1));
  if (!kept) return false;
  place.waits_for_snapshot = false;
  place.next = holds + 1;
  return true;
}

void PacketFeed::resend(FeedPlace& place, std::uint64_t first, std::uint64_t last) {
  if (place.waits_for_snapshot || place.snapshot) return;
  last = std::min(last, model_.held().sequence);
  if (first == 0 || first > last) return;
  if (first >= place.next) return;  // on its way
  last = std::min(last, place.next - 1);
  ++resends_;
  if (!history_.find(first) || !history_.find(last)) return start_over(place);
  if (place.resend.size() < kMaxResends) place.resend.push_back({first, last});
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

void PacketFeed::begin_snapshot(FeedPlace& place, const std::optional<Camera>& camera) {
  ++snapshots_;
  place.snapshot = current_snapshot();
  place.queue = place.snapshot->head;
  if (place.snapshot->as_of == model_.held().sequence) {
    for (const std::size_t chunk : model_.chunk_order(camera)) place.queue.push_back(place.snapshot->chunks[chunk]);
  } else {
    place.queue.insert(place.queue.end(), place.snapshot->chunks.begin(), place.snapshot->chunks.end());
  }
  place.queue.insert(place.queue.end(), place.snapshot->tail.begin(), place.snapshot->tail.end());
  place.queue_at = 0;
  place.next = place.snapshot->as_of + 1;
  place.waits_for_snapshot = false;
}

SharedPacket PacketFeed::next(FeedPlace& place, const std::optional<Camera>& camera, bool& lagged) {
  if (!model_.ready()) return {};
  while (!place.resend.empty()) {
    if (SharedPacket packet = history_.find(place.resend.front().first)) return packet;
    start_over(place);
  }
  if (place.waits_for_snapshot) begin_snapshot(place, camera);
  if (place.snapshot) return place.queue[place.queue_at];
  if (place.next > model_.held().sequence) return {};
  if (SharedPacket packet = history_.find(place.next)) return packet;
  lagged = true;  // the history has moved on
  begin_snapshot(place, camera);
  return place.queue[place.queue_at];
}

void PacketFeed::advance(FeedPlace& place) {
  if (!place.resend.empty()) {
    if (++place.resend.front().first > place.resend.front().last) place.resend.pop_front();
  } else if (place.snapshot) {
    if (++place.queue_at == place.queue.size()) {
      place.snapshot.reset();
      place.queue.clear();
    }
  } else {
    ++place.next;
  }
}

}  // namespace splatbus::streamer
