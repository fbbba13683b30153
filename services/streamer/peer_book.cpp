#include "streamer/peer_book.h"

#include <algorithm>
#include <iterator>
#include <utility>

namespace splatbus::streamer {

void PeerBook::left(const Endpoint::Peer& peer, const std::string& address, const std::string& name, Leaver leaver,
                    std::int64_t now_ns) {
  leavers_.push_back({peer, address, name, now_ns, std::move(leaver)});
  if (leavers_.size() > kMaxLeavers) leavers_.pop_front();
}

std::optional<PeerBook::Leaver> PeerBook::take_leaver(const Endpoint::Peer& peer, const std::string& address,
                                                      const std::string& name, std::int64_t now_ns) {
  leavers_.remove_if([&](const Entry& entry) { return now_ns - entry.left_ns > kRememberNs; });
  auto found = std::ranges::find(leavers_, peer, &Entry::peer);
  if (found == leavers_.end() && !address.empty()) {
    const auto is_here = [&](const Entry& entry) { return entry.address == address; };
    found = std::ranges::find_if(leavers_, [&](const Entry& entry) { return is_here(entry) && entry.name == name; });
    if (found == leavers_.end() && std::ranges::count_if(leavers_, is_here) > kForgiven) {
      // The last of them: whoever comes and goes then has one bucket to empty, and not that of each in turn.
      const auto last = std::find_if(leavers_.rbegin(), leavers_.rend(), is_here);
      found = std::next(last).base();
    }
  }
  if (found == leavers_.end()) return std::nullopt;
  Leaver leaver = std::move(found->leaver);
  leavers_.erase(found);
  return leaver;
}

}  // namespace splatbus::streamer
