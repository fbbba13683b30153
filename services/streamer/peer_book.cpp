#include "streamer/peer_book.h"

#include <algorithm>
#include <utility>

namespace splatbus::streamer {

void PeerBook::left(const Endpoint::Peer& peer, const std::string& address, Leaver leaver, std::int64_t now_ns) {
  leavers_.push_back({peer, address, now_ns, std::move(leaver)});
  if (leavers_.size() > kMaxLeavers) leavers_.pop_front();
}

std::optional<PeerBook::Leaver> PeerBook::take_leaver(const Endpoint::Peer& peer, const std::string& address,
                                                      std::int64_t now_ns) {
  leavers_.remove_if([&](const Entry& entry) { return now_ns - entry.left_ns > kRememberNs; });
  auto found = std::ranges::find(leavers_, peer, &Entry::peer);
  if (found == leavers_.end() && !address.empty()) found = std::ranges::find(leavers_, address, &Entry::address);
  if (found == leavers_.end()) return std::nullopt;
  Leaver leaver = std::move(found->leaver);
  leavers_.erase(found);
  return leaver;
}

}  // namespace splatbus::streamer
