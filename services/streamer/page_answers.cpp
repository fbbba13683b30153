#include "streamer/page_answers.h"

#include <algorithm>
#include <iterator>
#include <utility>

namespace splatbus::streamer {

namespace {

constexpr int kAnswersATurn = 64;  // to one peer: pages are encoded for it
constexpr std::int64_t kReplicaAnswersNs = 1'000'000'000;

}  // namespace

bool PageAnswers::take(const Endpoint::Peer& peer, const Request& request, std::int64_t now_ns) {
  Answer* answer = answer_to(peer, request.is_stranger, request.pages.size(), now_ns);
  if (!answer) return false;
  // One that is on its way answers for another: begun anew each time, a slow reader's would never end.
  if (request.manifest && answer->manifest_left == 0) {
    const auto add = [&](SharedPacket packet) {
      answer->items.push_back({.packet = std::move(packet), .asked = {}, .of_manifest = true});
      ++answer->manifest_left;
    };
    add(board_.layout());
    for (const SharedPacket& part : board_.manifest()) add(part);
  }
  for (const stream::PageVersion& page : request.pages) {
    answer->items.push_back({.packet = {}, .asked = page, .epoch = request.epoch, .asked_ns = now_ns});
  }
  if (!send_some(peer, *answer, now_ns)) answers_.erase(peer);
  return true;
}

PageAnswers::Answer* PageAnswers::answer_to(const Endpoint::Peer& peer, bool is_stranger, std::size_t pages,
                                            std::int64_t now_ns) {
  const auto found = answers_.find(peer);
  if (found != answers_.end()) {
    Answer& answer = found->second;
    return answer.items.size() - answer.manifest_left + pages > kMaxPages ? nullptr : &answer;
  }
  const auto strangers = static_cast<std::size_t>(
      std::ranges::count_if(answers_, [](const auto& entry) { return entry.second.is_stranger; }));
  if (is_stranger && strangers >= kMaxStrangers) return nullptr;
  Answer& answer = answers_[peer];
  answer.is_stranger = is_stranger;
  answer.moved_ns = now_ns;
  return &answer;
}

bool PageAnswers::pump(std::int64_t now_ns) {
  look_at_waiting(now_ns);
  for (auto at = answers_.begin(); at != answers_.end();) {
    at = send_some(at->first, at->second, now_ns) ? std::next(at) : answers_.erase(at);
  }
  return !answers_.empty();
}

void PageAnswers::restart() {
  for (auto& [peer, answer] : answers_) {
    std::erase_if(answer.items, [](const Item& item) { return item.of_manifest; });
    answer.manifest_left = 0;
  }
}

bool PageAnswers::send_some(const Endpoint::Peer& peer, Answer& answer, std::int64_t now_ns) {
  for (int k = 0; k < kAnswersATurn && !answer.items.empty(); ++k) {
    if (!answer.items.front().packet) {
      resolve_front(peer, answer, now_ns);
      continue;
    }
    const auto sent = send_(peer, *answer.items.front().packet);
    if (sent == Endpoint::Sent::Gone) return false;
    if (sent == Endpoint::Sent::Full) return now_ns - answer.moved_ns <= kStalledNs;
    answer.moved_ns = now_ns;
    if (answer.items.front().of_manifest) --answer.manifest_left;
    answer.items.pop_front();
  }
  return !answer.items.empty();
}

// A page's packets in place of its name; pages that follow each other and are no more, in one packet.
void PageAnswers::resolve_front(const Endpoint::Peer& peer, Answer& answer, std::int64_t now_ns) {
  auto& items = answer.items;
  const State state = state_of(items.front(), now_ns);
  if (state == State::Gone) {
    std::vector<std::uint32_t> gone;
    do {
      gone.push_back(items.front().asked.page);
      items.pop_front();
    } while (!items.empty() && !items.front().packet && state_of(items.front(), now_ns) == State::Gone);
    items.push_front({.packet = std::make_shared<WirePacket>(model_.gone_packet(gone)), .asked = {}});
    return;
  }
  Item item = std::move(items.front());
  items.pop_front();
  if (state == State::Waits) {
    waiting_.push_back({peer, answer.is_stranger, std::move(item)});
    return;
  }
  const auto page = board_.page(item.asked.page, false, false);
  for (auto part = page->parts.rbegin(); part != page->parts.rend(); ++part) {
    items.push_front({.packet = *part, .asked = {}});
  }
}

PageAnswers::State PageAnswers::state_of(const Item& item, std::int64_t now_ns) {
  const stream::OfferedPage* offered = board_.find(item.asked.page);
  if (!offered || item.epoch != model_.status().epoch) return State::Gone;
  const auto page = board_.page(item.asked.page, false, false);
  if (page && page->version == item.asked.version) return State::Here;
  const bool comes = board_.is_of_others(item.asked.page) && offered->version <= item.asked.version &&
                     now_ns - item.asked_ns < kReplicaAnswersNs;
  return comes ? State::Waits : State::Gone;
}

// These are behind what their peers have asked for since.
void PageAnswers::look_at_waiting(std::int64_t now_ns) {
  std::deque<Waiting> still;
  for (Waiting& waiting : waiting_) {
    if (state_of(waiting.item, now_ns) == State::Waits) {
      still.push_back(std::move(waiting));
    } else if (Answer* answer = answer_to(waiting.peer, waiting.is_stranger, 1, now_ns)) {
      answer->items.push_back(std::move(waiting.item));
    }
  }
  waiting_ = std::move(still);
}

}  // namespace splatbus::streamer
