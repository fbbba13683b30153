#include "streamer/viewer_hub.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <utility>

namespace splatbus::streamer {

namespace {

constexpr int kPacketsATurn = 256;
constexpr std::size_t kMaxPictures = 8;
constexpr std::size_t kMaxScenes = 8;  // that wait for one viewer; then one whole one does
constexpr std::size_t kMaxPictureBytes = std::size_t{64} << 20;
constexpr std::size_t kCamerasATick = 4;
constexpr std::int64_t kLimitsToAcknowledge = 3;  // probe pictures may be on the way before what is numbered

}  // namespace

ViewerHub::ViewerHub(Endpoint& endpoint, stream::StreamModel& model, stream::PacketWriter writer, HubOptions options,
                     HubEvents events)
    : endpoint_(endpoint),
      model_(model),
      writer_(std::move(writer)),
      options_(options),
      events_(std::move(events)),
      board_(model, options.history_bytes),
      answers_(board_, model, [this](const auto& peer, const WirePacket& packet) { return send(peer, packet); }),
      book_(options.max_viewers_per_address),
      connections_(writer_.source_epoch()) {}

void ViewerHub::say(const std::string& text) {
  if (log_limiter_.allow()) spdlog::info("{}", text);
}

void ViewerHub::begin(Viewer& viewer, bool has_scene) {
  std::vector<SharedPacket> packets{board_.layout()};
  if (!has_scene) {
    viewer.feed.drop_scenes();
    if (SharedPacket scene = whole_scene()) packets.push_back(std::move(scene));
  }
  const auto& manifest = board_.manifest();
  packets.insert(packets.end(), manifest.begin(), manifest.end());
  viewer.feed.begin(std::move(packets));
}

// Made once for all who ask for it: who says often enough that it has lost it would keep us busy.
SharedPacket ViewerHub::whole_scene() {
  const std::uint64_t epoch = model_.status().epoch, version = model_.scene_version();
  if (whole_scene_.packet && whole_scene_.epoch == epoch && whole_scene_.version == version) return whole_scene_.packet;
  const auto scene = model_.scene_packet();
  if (!scene) return {};
  whole_scene_ = {epoch, version, std::make_shared<WirePacket>(*scene)};
  return whole_scene_.packet;
}

void ViewerHub::add(stream::StreamUpdate update, BoardPages pages) {
  std::vector<stream::OfferedPage> changed;
  std::vector<std::uint32_t> ended = std::move(update.gone);
  const std::vector<std::uint32_t> gone = board_.add(std::move(update), std::move(pages), changed);
  // What another replica has now is shown as it is until it comes from there.
  std::erase_if(ended, [this](std::uint32_t page) { return board_.is_of_others(page); });
  if (viewers_.empty()) return;
  std::vector<SharedPacket> news;
  if (!changed.empty() || !gone.empty()) {
    for (const auto& packet : board_.manifest_packets(changed, gone, false)) {
      news.push_back(std::make_shared<WirePacket>(packet));
    }
  }
  for (auto& [peer, viewer] : viewers_) {
    viewer.feed.push_gone(model_, ended);
    for (const SharedPacket& packet : news) viewer.feed.push_news(packet);
  }
}

void ViewerHub::add_scene(const stream::EncodedPacket& packet) {
  const auto shared = std::make_shared<WirePacket>(packet);
  for (auto& [peer, viewer] : viewers_) {
    if (viewer.feed.scenes() < kMaxScenes) {
      viewer.feed.push_scene(shared);
      continue;
    }
    viewer.feed.drop_scenes();
    viewer.feed.push_scene(whole_scene());
  }
}

void ViewerHub::add_visibility(std::vector<stream::VisibilityPacket> packets) {
  for (stream::VisibilityPacket& packet : packets) {
    board_.forget(packet.pages);
    board_.stamp(packet.packet);
    const auto shared = std::make_shared<WirePacket>(packet.packet);
    const auto pages = std::make_shared<const std::vector<wire::SeenPage>>(std::move(packet.pages));
    for (auto& [peer, viewer] : viewers_) viewer.feed.push_visibility(shared, pages);
  }
}

void ViewerHub::restart_all(BoardPages pages) {
  board_.clear();
  answers_.restart();
  add({}, std::move(pages));
  for (auto& [peer, viewer] : viewers_) {
    viewer.feed.start_over();
    begin(viewer, false);
  }
}

Endpoint::Sent ViewerHub::send(const Endpoint::Peer& peer, const WirePacket& packet, std::uint64_t sequence) {
  const auto sent = endpoint_.send(peer, packet, sequence);
  if (sent == Endpoint::Sent::Yes) statistics_.add(packet.body(), packet.bytes());
  return sent;
}

Endpoint::Sent ViewerHub::send_next(const Endpoint::Peer& peer, Viewer& viewer, std::int64_t now_ns, bool& idle) {
  if (const SharedPacket packet = viewer.feed.next(model_, board_, viewer.gaze.gaze(), objects_, now_ns)) {
    const auto sent = send(peer, *packet, viewer.feed.next_sequence());
    if (sent == Endpoint::Sent::Yes) viewer.feed.sent(now_ns);
    return sent;
  }
  idle = viewer.pictures.empty();
  if (idle) return Endpoint::Sent::Yes;
  // Measurements ask for these, and their rate is not the stream's.
  const auto sent = send(peer, *viewer.pictures.front());
  if (sent == Endpoint::Sent::Yes) viewer.pictures.pop_front();
  return sent;
}

void ViewerHub::set_rate(ViewerFeed& feed, std::int64_t now_ns) const {
  const bool joins = options_.viewer_kbps > 0 && !feed.was_whole();
  feed.rate().set(joins ? std::max(options_.viewer_kbps, options_.join_kbps) : options_.viewer_kbps, feed.most_kbps(),
                  now_ns);
}

bool ViewerHub::pump(std::int64_t now_ns) {
  bool waits = answers_.pump(now_ns);
  for (auto at = viewers_.begin(); at != viewers_.end();) {
    Viewer& viewer = at->second;
    set_rate(viewer.feed, now_ns);
    auto sent = Endpoint::Sent::Yes;
    bool idle = false;
    for (int k = 0; k < kPacketsATurn && sent == Endpoint::Sent::Yes && !idle; ++k) {
      sent = send_next(at->first, viewer, now_ns, idle);
      if (sent == Endpoint::Sent::Yes) viewer.sent_ns = now_ns;  // it reads, however slowly
    }
    waits = waits || !idle || viewer.feed.waits();
    if (sent == Endpoint::Sent::Gone) {
      say(fmt::format("viewer {} is gone", viewer.name));
      remember(at->first, viewer, now_ns);
      at = viewers_.erase(at);
      if (viewers_.empty()) empty_since_ns_ = now_ns;
    } else {
      ++at;
    }
  }
  return waits;
}

std::optional<double> ViewerHub::delta_bytes_per_s() const {
  std::optional<double> most;
  for (const auto& [peer, viewer] : viewers_) most = std::max(most.value_or(0), viewer.feed.delta_bytes_per_s());
  return most;
}

void ViewerHub::send_keepalive(std::int64_t now_ns) {
  const std::uint64_t epoch = model_.status().epoch;
  const std::size_t all = gaussians(), in = pages();
  for (auto& [peer, viewer] : viewers_) {
    const auto kbps = static_cast<std::uint32_t>(viewer.feed.rate().bytes_per_s() / 125);
    const WirePacket packet(writer_.write(epoch, 0, wire::Body::Keepalive, [&](auto& builder) {
      return wire::CreateKeepalive(builder, all, static_cast<std::uint32_t>(in),
                                   static_cast<std::uint32_t>(viewers_.size()), kbps);
    }));
    if (send(peer, packet, viewer.feed.next_sequence()) == Endpoint::Sent::Yes) {
      viewer.feed.sent_beside(static_cast<double>(packet.bytes()), now_ns);
    }
  }
}

void ViewerHub::expire(std::int64_t now_ns) {
  if (readers_.expire(now_ns) && viewers_.empty()) empty_since_ns_ = now_ns;
  const auto limit_ns = static_cast<std::int64_t>(options_.viewer_timeout_s * 1e9);
  const auto gone = std::erase_if(viewers_, [&](const auto& entry) {
    const Viewer& viewer = entry.second;
    const bool silent = now_ns - viewer.heard_ns > limit_ns;
    const std::int64_t owes_ns = now_ns - viewer.feed.rate().owes_since_ns().value_or(now_ns);
    const bool stuck = now_ns - viewer.sent_ns > limit_ns || owes_ns > kLimitsToAcknowledge * limit_ns;
    if (silent || stuck) {
      ++lost_viewers_;
      say(fmt::format("viewer {} {} nothing for {} s and is forgotten", viewer.name, silent ? "sent" : "read",
                      options_.viewer_timeout_s));
      remember(entry.first, viewer, now_ns);
    }
    return silent || stuck;
  });
  if (gone > 0 && viewers_.empty()) empty_since_ns_ = now_ns;
}

void ViewerHub::remember(const Endpoint::Peer& peer, const Viewer& viewer, std::int64_t now_ns) {
  book_.left(peer, viewer.address, viewer.name,
             {.limits = viewer.limits, .spent = viewer.feed.rate().spent(), .posed_ns = viewer.posed_ns}, now_ns);
  former_.whole_pages += viewer.feed.whole_pages();
  former_.lost_packets += viewer.feed.lost_packets();
  former_.refused_pages += viewer.feed.refused_pages();
}

void ViewerHub::send_probe_picture(std::uint64_t probe_id, const stream::EncodedPacket& picture) {
  const auto packet = std::make_shared<WirePacket>(picture);
  const auto asked = probes_.extract(probe_id);
  for (auto& [peer, viewer] : viewers_) {
    const bool wanted = asked ? asked.mapped().asker == peer : viewer.wants_probes && viewer.rights.probe;
    if (!wanted) continue;
    viewer.compared.push_back(probe_id);
    if (viewer.compared.size() > kProbesInFlight) viewer.compared.pop_front();
    viewer.pictures.push_back(packet);
    std::size_t bytes = 0;
    for (const SharedPacket& waiting : viewer.pictures) bytes += waiting->bytes();
    while (viewer.pictures.size() > 1 && (viewer.pictures.size() > kMaxPictures || bytes > kMaxPictureBytes)) {
      bytes -= viewer.pictures.front()->bytes();
      viewer.pictures.pop_front();
    }
  }
}

double ViewerHub::empty_s(std::int64_t now_ns) const {
  return is_followed() ? 0 : static_cast<double>(now_ns - empty_since_ns_) * 1e-9;
}

std::vector<Camera> ViewerHub::cameras() {
  std::vector<Camera> all;
  for (const auto& [peer, viewer] : viewers_) {
    if (viewer.gaze.gaze()) all.push_back(viewer.gaze.gaze()->now);
  }
  if (all.size() <= kCamerasATick) return all;
  std::vector<Camera> some;
  for (std::size_t k = 0; k < kCamerasATick; ++k) some.push_back(all[camera_turn_++ % all.size()]);
  return some;
}

std::set<std::uint32_t> ViewerHub::followed_pages() const {
  std::set<std::uint32_t> pages;
  for (const auto& [peer, viewer] : viewers_) viewer.feed.follow_pages(pages);
  return pages;
}

ViewerHub::Counts ViewerHub::counts() const {
  Counts counts = former_;
  for (const auto& [peer, viewer] : viewers_) {
    counts.whole_pages += viewer.feed.whole_pages();
    counts.lost_packets += viewer.feed.lost_packets();
    counts.refused_pages += viewer.feed.refused_pages();
  }
  return counts;
}

}  // namespace splatbus::streamer
