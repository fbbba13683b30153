// Pages that other replicas encode.

#include <algorithm>
#include <utility>

#include "streamer/page_board.h"

namespace splatbus::streamer {

namespace {

constexpr std::int64_t kForgottenNs = 5'000'000'000;

}  // namespace

void PageBoard::offer_others(BoardPages& pages) {
  of_others_ = std::move(pages.of_others);
  gaussians_.reset();
  if (!of_others_.empty()) {
    std::size_t all = 0;
    for (const stream::OfferedPage& page : *pages.all) all += page.count;
    gaussians_ = all;
  }
  std::erase_if(seen_, [&](const auto& entry) { return !is_of_others(entry.first); });
  std::erase_if(wanted_, [&](const auto& entry) { return !is_of_others(entry.first.page); });
}

bool PageBoard::is_of_now(const ShareAnswer& seen) const {
  const stream::OfferedPage* offered = find(seen.what.page);
  return offered && seen.structure >= offered->structure;
}

bool PageBoard::is_of_others(std::uint32_t page) const {
  return std::ranges::binary_search(of_others_, page);
}

std::vector<SharedPacket> PageBoard::page_visibility(std::uint32_t page) {
  std::vector<stream::EncodedPacket> packets;
  if (!is_of_others(page)) {
    packets = model_.page_visibility(page);
  } else if (const auto seen = seen_.find(page); seen != seen_.end() && is_of_now(seen->second)) {
    packets = seen->second.packets;
  } else {
    need({page, wire::SharePart::Visibility});
  }
  std::vector<SharedPacket> out;
  for (stream::EncodedPacket& packet : packets) {
    stamp(packet);
    out.push_back(std::make_shared<WirePacket>(packet));
  }
  return out;
}

void PageBoard::take(ShareAnswer answer) {
  const stream::OfferedPage* offered = find(answer.what.page);
  if (!offered || !is_of_others(answer.what.page) || !wanted_.contains(answer.what)) return;
  if (answer.what.part == wire::SharePart::Visibility) {
    if (answer.structure < offered->structure) return;
    wanted_.erase(answer.what);
    seen_[answer.what.page] = std::move(answer);
    return;
  }
  if (answer.version < offered->version) return;
  wanted_.erase(answer.what);
  auto page = std::make_shared<SharedPage>();
  page->version = answer.version;
  page->structure = answer.structure;
  for (const stream::EncodedPacket& part : answer.packets) page->parts.push_back(std::make_shared<WirePacket>(part));
  learn_bytes(answer.what.page, answer_bytes(answer));
  pages_[{answer.what.page, answer.what.part == wire::SharePart::Parts}] = std::move(page);
}

std::vector<ShareWant> PageBoard::take_wants(std::int64_t now_ns) {
  std::vector<ShareWant> wants;
  for (auto& [want, wanted] : wanted_) {
    if (wants.size() >= kMaxShareWants) break;
    if (!wanted.needed || (wanted.asked_ns != 0 && now_ns - wanted.asked_ns < kAskNs)) continue;
    wanted = {.needed = false, .asked_ns = now_ns};
    wants.push_back(want);
  }
  std::erase_if(wanted_, [&](const auto& entry) {
    return !entry.second.needed && now_ns - entry.second.asked_ns > kForgottenNs;
  });
  return wants;
}

void PageBoard::stamp(stream::EncodedPacket& visibility) {
  auto* packet = flatbuffers::GetMutableRoot<wire::Packet>(visibility.packet.data());
  auto* body = static_cast<wire::LightVisibility*>(packet->mutable_body());
  if (body->scene_version() >= visibility_version_) {
    visibility_version_ = body->scene_version();
  } else {
    body->mutate_scene_version(visibility_version_);
  }
}

}  // namespace splatbus::streamer
