// What the hubs of replicas that share pages do for each other.

#include <algorithm>
#include <utility>

#include "streamer/viewer_hub.h"

namespace splatbus::streamer {

namespace {

constexpr std::int64_t kReaderWaitsNs = 1'000'000'000;

}  // namespace

void ViewerHub::add_others_visibility(std::vector<stream::VisibilityPacket> packets, const SceneState& scene) {
  std::vector<stream::VisibilityPacket> known;
  for (stream::VisibilityPacket& packet : packets) {
    const std::uint32_t light =
        flatbuffers::GetRoot<wire::Packet>(packet.packet.packet.data())->body_as_LightVisibility()->light_id();
    const auto& sources = scene.light.sources;
    if (light == 0 || std::ranges::find(sources, light, &LightSource::id) != sources.end()) {
      known.push_back(std::move(packet));
      continue;
    }
    // Of a light that is on its way here: a viewer that lacks it would refuse the packet.
    board_.forget(packet.pages);
    for (auto& [peer, viewer] : viewers_) viewer.feed.miss_visibility(packet.pages);
  }
  add_visibility(std::move(known));
}

std::optional<ShareAnswer> ViewerHub::answer(const ShareWant& want) {
  if (!board_.find(want.page) || board_.is_of_others(want.page)) return std::nullopt;
  ShareAnswer answer{.what = want, .packets = {}};
  if (want.part == wire::SharePart::Visibility) {
    for (const SharedPacket& packet : board_.page_visibility(want.page)) answer.packets.push_back(packet->copy());
  } else if (const auto page = board_.page(want.page, want.part == wire::SharePart::Parts)) {
    for (const SharedPacket& packet : page->parts) answer.packets.push_back(packet->copy());
  }
  if (answer.packets.empty()) return std::nullopt;
  return answer;
}

bool ViewerHub::send_page(const Endpoint::Peer& peer, const stream::PageVersion& asked, std::uint64_t epoch) {
  const auto page = board_.find(asked.page) ? board_.page(asked.page, false, false) : nullptr;
  if (!page || page->version != asked.version || epoch != model_.status().epoch) return false;
  for (const SharedPacket& part : page->parts) send(peer, *part);
  return true;
}

void ViewerHub::answer_readers(std::int64_t now_ns) {
  std::erase_if(waiting_, [&](const Waiting& waiting) {
    if (send_page(waiting.peer, waiting.asked, waiting.epoch)) return true;
    const bool another = !board_.is_of_others(waiting.asked.page) || waiting.epoch != model_.status().epoch ||
                         board_.find(waiting.asked.page)->version > waiting.asked.version;
    if (!another && now_ns - waiting.asked_ns < kReaderWaitsNs) return false;
    send(waiting.peer, WirePacket(model_.gone_packet(std::vector{waiting.asked.page})));
    return true;
  });
}

}  // namespace splatbus::streamer
