#include "streamer/viewer_hub.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <utility>

#include "bus/frames.h"
#include "wire/convert.h"

namespace splatbus::streamer {

namespace {

constexpr int kMessagesACall = 512;
constexpr std::size_t kMaxProbes = 1024;
constexpr std::size_t kMaxPictures = 8;
constexpr std::size_t kMaxPictureBytes = std::size_t{64} << 20;

}  // namespace

ViewerHub::ViewerHub(Endpoint& endpoint, stream::StreamModel& model, stream::PacketWriter writer, HubOptions options,
                     HubEvents events)
    : endpoint_(endpoint),
      model_(model),
      writer_(std::move(writer)),
      options_(options),
      events_(std::move(events)),
      feed_(model, options.history_bytes) {}

void ViewerHub::receive(std::int64_t now_ns) {
  for (int i = 0; i < kMessagesACall; ++i) {
    const auto received = endpoint_.receive();
    if (!received) return;
    try {
      handle(*received, now_ns);
    } catch (const std::runtime_error& error) {
      if (log_limiter_.allow())
        spdlog::warn("a viewer's {}: {}", wire::EnumNameBody(received->packet.body()), error.what());
    }
  }
}

stream::EncodedPacket ViewerHub::welcome(bool asks) const {
  const stream::StreamModel::Status held = model_.status();
  const ParameterLayout& layout = held.layout;
  const bool transfer = layout.appearance == Appearance::Transfer;
  return writer_.write(held.epoch, 0, wire::Body::Welcome, [&](auto& builder) {
    return wire::CreateWelcome(builder, transfer ? wire::Appearance::Transfer : wire::Appearance::Radiance,
                               static_cast<std::uint8_t>(transfer ? 0 : layout.sh_degree), held.epoch, options_.tick_hz,
                               asks);
  });
}

void ViewerHub::handle(const Endpoint::Received& received, std::int64_t now_ns) {
  const auto& [peer, packet, rights] = received;
  const wire::Packet& root = packet.root();
  if (packet.body() == wire::Body::Hello) return hello(peer, packet, now_ns);
  const auto found = viewers_.find(peer);
  if (found == viewers_.end()) {
    if (packet.body() != wire::Body::Bye) send(peer, WirePacket(welcome(true)));
    return;
  }
  Viewer& viewer = found->second;
  viewer.heard_ns = now_ns;
  const bool same_epoch = packet.stream_epoch() == model_.status().epoch;
  switch (packet.body()) {
    case wire::Body::Pose:
      viewer.camera = from_wire(*root.body_as_Pose()->camera());
      if (rights.steer) events_.pose(viewer.name, *root.body_as_Pose());
      break;
    case wire::Body::Probe: {
      if (!rights.probe) break;
      const wire::Probe& probe = *root.body_as_Probe();
      static_cast<void>(from_wire(*probe.camera()));  // refuses what makes no sense
      if (probe_askers_.size() >= kMaxProbes) probe_askers_.erase(probe_askers_.begin());
      probe_askers_[probe.probe_id()] = peer;
      events_.probe(viewer.name, probe);
      break;
    }
    case wire::Body::Quality:
      if (rights.probe) events_.quality(viewer.name, *root.body_as_Quality());
      break;
    case wire::Body::Resend:
      if (same_epoch) feed_.resend(viewer.cursor, root.body_as_Resend()->first(), root.body_as_Resend()->last());
      break;
    case wire::Body::NeedSnapshot: {
      const auto* reason = root.body_as_NeedSnapshot()->reason();
      if (log_limiter_.allow()) {
        spdlog::info("viewer {} needs a snapshot: {}", viewer.name,
                     bus::printable(reason ? reason->string_view() : ""));
      }
      PacketFeed::start_over(viewer.cursor);
      break;
    }
    case wire::Body::Bye:
      spdlog::info("viewer {} left", viewer.name);
      viewers_.erase(found);
      break;
    default:
      spdlog::debug("viewer {} sent a {}", viewer.name, wire::EnumNameBody(packet.body()));
  }
}

void ViewerHub::hello(const Endpoint::Peer& peer, const stream::ParsedPacket& packet, std::int64_t now_ns) {
  const wire::Hello& body = *packet.root().body_as_Hello();
  if (const auto known = viewers_.find(peer); known != viewers_.end()) {
    known->second.heard_ns = now_ns;
    send(peer, WirePacket(welcome(false)));  // it repeated itself before the Welcome was there
    return;
  }
  if (viewers_.size() >= options_.max_viewers) {
    send(peer, WirePacket(writer_.write(model_.status().epoch, 0, wire::Body::Bye, [&](auto& builder) {
           return wire::CreateByeDirect(builder,
                                        fmt::format("{} viewers are all that are served", viewers_.size()).c_str());
         })));
    return;
  }
  Viewer viewer;
  viewer.name = bus::printable(body.viewer()->string_view());
  viewer.wants_probes = body.probes();
  viewer.heard_ns = viewer.sent_ns = now_ns;
  if (body.camera()) viewer.camera = from_wire(*body.camera());
  const bool resumes = feed_.resume(viewer.cursor, packet.stream_epoch(), body.holds());
  spdlog::info("viewer {} {}", viewer.name, resumes ? "is back" : "joined");
  statistics_.begin(now_ns);
  viewers_[peer] = std::move(viewer);
  send(peer, WirePacket(welcome(false)));
}

void ViewerHub::broadcast(const std::vector<stream::EncodedPacket>& packets) {
  feed_.add(packets);
}

void ViewerHub::restart_all() {
  feed_.clear();
  for (auto& [peer, viewer] : viewers_) PacketFeed::start_over(viewer.cursor);
}

SharedPacket ViewerHub::next_packet(Viewer& viewer, std::int64_t now_ns, bool settled) {
  bool lagged = false;
  SharedPacket packet = feed_.next(viewer.cursor, viewer.camera, now_ns, settled, lagged);
  if (lagged) {
    ++lost_viewers_;
    spdlog::warn("viewer {} does not keep up and gets a snapshot", viewer.name);
  }
  if (packet) return packet;
  return viewer.pictures.empty() ? SharedPacket() : viewer.pictures.front();
}

void ViewerHub::advance(Viewer& viewer, const SharedPacket& sent) {
  if (sent->body() == wire::Body::ProbePicture) {
    viewer.pictures.pop_front();
  } else {
    PacketFeed::advance(viewer.cursor);
  }
}

bool ViewerHub::pump(std::int64_t now_ns, bool settled) {
  bool full = false;
  for (auto at = viewers_.begin(); at != viewers_.end();) {
    Viewer& viewer = at->second;
    auto sent = Endpoint::Sent::Yes;
    bool idle = false;
    while (sent == Endpoint::Sent::Yes) {
      const SharedPacket packet = next_packet(viewer, now_ns, settled);
      idle = !packet;
      if (idle) break;
      sent = send(at->first, *packet);
      if (sent != Endpoint::Sent::Yes) break;
      advance(viewer, packet);
      viewer.sent_ns = now_ns;  // it reads, however slowly
    }
    if (idle) viewer.sent_ns = now_ns;
    full = full || sent == Endpoint::Sent::Full;
    if (sent == Endpoint::Sent::Gone) {
      spdlog::info("viewer {} is gone", viewer.name);
      at = viewers_.erase(at);
    } else {
      ++at;
    }
  }
  return full;
}

Endpoint::Sent ViewerHub::send(const Endpoint::Peer& peer, const WirePacket& packet) {
  const auto sent = endpoint_.send(peer, packet);
  if (sent == Endpoint::Sent::Yes) statistics_.add(packet.body(), packet.bytes());
  return sent;
}

void ViewerHub::send_keepalive() {
  for (const auto& [peer, viewer] : viewers_) {
    // Only what has been sent can have been lost.
    const bool follows = !viewer.cursor.waits_for_snapshot && !viewer.cursor.snapshot;
    const std::uint64_t last_sent = follows ? viewer.cursor.next - 1 : 0;
    send(peer, WirePacket(writer_.write(model_.status().epoch, 0, wire::Body::Keepalive, [&](auto& builder) {
           return wire::CreateKeepalive(builder, last_sent, model_.status().gaussians,
                                        static_cast<std::uint32_t>(viewers_.size()));
         })));
  }
}

void ViewerHub::expire(std::int64_t now_ns) {
  const auto limit_ns = static_cast<std::int64_t>(options_.viewer_timeout_s * 1e9);
  std::erase_if(viewers_, [&](const auto& entry) {
    const Viewer& viewer = entry.second;
    const bool silent = now_ns - viewer.heard_ns > limit_ns, stuck = now_ns - viewer.sent_ns > limit_ns;
    if (silent || stuck) {
      ++lost_viewers_;
      spdlog::warn("viewer {} {} nothing for {} s and is forgotten", viewer.name, silent ? "sent" : "read",
                   options_.viewer_timeout_s);
    }
    return silent || stuck;
  });
}

void ViewerHub::send_probe_picture(std::uint64_t probe_id, const stream::EncodedPacket& picture) {
  const auto packet = std::make_shared<WirePacket>(picture);
  const auto asker = probe_askers_.extract(probe_id);
  for (auto& [peer, viewer] : viewers_) {
    if (!viewer.wants_probes && (!asker || asker.mapped() != peer)) continue;
    viewer.pictures.push_back(packet);
    std::size_t bytes = 0;
    for (const SharedPacket& waiting : viewer.pictures) bytes += waiting->bytes();
    while (viewer.pictures.size() > 1 && (viewer.pictures.size() > kMaxPictures || bytes > kMaxPictureBytes)) {
      bytes -= viewer.pictures.front()->bytes();
      viewer.pictures.pop_front();
    }
  }
}

bool ViewerHub::anybody_follows() const {
  return std::ranges::any_of(viewers_, [](const auto& entry) { return !entry.second.cursor.waits_for_snapshot; });
}

std::vector<Camera> ViewerHub::cameras() const {
  std::vector<Camera> cameras;
  for (const auto& [peer, viewer] : viewers_) {
    if (viewer.camera) cameras.push_back(*viewer.camera);
  }
  return cameras;
}

}  // namespace splatbus::streamer
