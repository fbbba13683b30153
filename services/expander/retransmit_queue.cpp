#include "expander/retransmit_queue.h"

#include <algorithm>
#include <utility>

namespace splatbus::expander {

void RetransmitQueue::add(InsertBatch batch) {
  batch.batch = ++last_batch_;
  gaussians_ += batch.size();
  pending_.push_back({.batch = std::move(batch)});
}

std::vector<const InsertBatch*> RetransmitQueue::due(std::int64_t now_ns) {
  std::vector<const InsertBatch*> batches;
  std::size_t in_flight = 0;
  for (Entry& entry : pending_) {
    if (++in_flight > options_.in_flight) break;
    if (entry.sent_ns != 0 && now_ns - entry.sent_ns < options_.resend_ns) continue;
    entry.sent_ns = now_ns;
    batches.push_back(&entry.batch);
  }
  return batches;
}

bool RetransmitQueue::all_sent() const {
  return std::all_of(pending_.begin(), pending_.end(), [](const Entry& entry) { return entry.sent_ns != 0; });
}

std::size_t RetransmitQueue::acknowledge(std::span<const std::uint64_t> batches) {
  const std::unordered_set<std::uint64_t> listed(batches.begin(), batches.end());
  const std::size_t before = pending_.size();
  acknowledge_if([&](const InsertBatch& batch) { return listed.contains(batch.batch); });
  return before - pending_.size();
}

void RetransmitQueue::acknowledge_if(const std::function<bool(const InsertBatch&)>& in_model) {
  std::deque<Entry> still;
  for (Entry& entry : pending_) {
    if (in_model(entry.batch)) {
      keep(std::move(entry));
    } else {
      still.push_back(std::move(entry));
    }
  }
  pending_ = std::move(still);
}

void RetransmitQueue::keep(Entry entry) {
  ++acknowledged_;
  kept_bytes_ += entry.batch.bytes();
  kept_.push_back(std::move(entry.batch));
  while (kept_bytes_ > options_.kept_bytes && !kept_.empty()) {
    kept_bytes_ -= kept_.front().bytes();
    kept_.pop_front();
    ++forgotten_;
  }
}

void RetransmitQueue::restart() {
  std::deque<Entry> all;
  for (InsertBatch& batch : kept_) all.push_back({.batch = std::move(batch)});
  for (Entry& entry : pending_) all.push_back({.batch = std::move(entry.batch)});
  for (Entry& entry : all) entry.batch.batch = ++last_batch_;
  pending_ = std::move(all);
  kept_.clear();
  kept_bytes_ = 0;
  acknowledged_ = 0;
}

std::vector<const InsertBatch*> RetransmitQueue::pending_batches() const {
  std::vector<const InsertBatch*> batches;
  batches.reserve(pending_.size());
  for (const Entry& entry : pending_) batches.push_back(&entry.batch);
  return batches;
}

}  // namespace splatbus::expander
