// What the hubs of replicas that share pages do for each other.

#include <algorithm>
#include <utility>

#include "streamer/viewer_hub.h"

namespace splatbus::streamer {

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

}  // namespace splatbus::streamer
