// What viewers say, and what is taken of it.

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <optional>
#include <stdexcept>
#include <utility>

#include "bus/frames.h"
#include "streamer/viewer_hub.h"
#include "wire/convert.h"
#include "wire/picture_size.h"

namespace splatbus::streamer {

namespace {

constexpr int kMessagesACall = 512;
constexpr std::int64_t kPoseEveryNs = 15'000'000;
constexpr std::int64_t kProbeNs = 20'000'000'000;  // an answer that has not come by then will not

}  // namespace

void ViewerHub::receive(std::int64_t now_ns) {
  for (int i = 0; i < kMessagesACall; ++i) {
    const auto received = endpoint_.receive();
    if (!received) break;
    try {
      handle(*received, now_ns);
    } catch (const std::runtime_error& error) {
      if (log_limiter_.allow())
        spdlog::warn("a viewer's {}: {}", wire::EnumNameBody(received->packet.body()), error.what());
    }
  }
  for (auto& [peer, viewer] : viewers_) pass_pose(viewer, now_ns);
}

stream::EncodedPacket ViewerHub::welcome(std::uint64_t connection) const {
  const stream::StreamModel::Status held = model_.status();
  const ParameterLayout& layout = held.layout;
  const bool transfer = layout.appearance == Appearance::Transfer;
  return writer_.write(held.epoch, 0, wire::Body::Welcome, [&](auto& builder) {
    return wire::CreateWelcome(builder, transfer ? wire::Appearance::Transfer : wire::Appearance::Radiance,
                               static_cast<std::uint8_t>(transfer ? 0 : layout.sh_degree), held.epoch, options_.tick_hz,
                               connection == 0, connection);
  });
}

void ViewerHub::handle(const Endpoint::Received& received, std::int64_t now_ns) {
  const auto& [peer, packet, rights, address, is_service] = received;
  const wire::Packet& root = packet.root();
  const auto found = viewers_.find(peer);
  if (packet.body() == wire::Body::PageRequest) {
    if (found != viewers_.end()) found->second.heard_ns = now_ns;
    take_page_request(received, now_ns);
    return;
  }
  if (found == viewers_.end()) {
    const bool greets = packet.body() == wire::Body::Hello;
    if (greets ? !book_.admits(peer, address, now_ns) : !book_.answers(peer, now_ns)) {
      ++ignored_;
    } else if (greets) {
      hello(received, now_ns);
    } else if (packet.body() != wire::Body::Bye) {
      send(peer, WirePacket(welcome(0)));
    }
    return;
  }
  Viewer& viewer = found->second;
  viewer.heard_ns = now_ns;
  viewer.rights = rights;
  if (!viewer.limits.allow(packet.body(), now_ns)) {
    ++ignored_;
    return;
  }
  switch (packet.body()) {
    case wire::Body::Hello:
      send(peer, WirePacket(welcome(viewer.connection)));  // it repeated itself before the Welcome was there
      break;
    case wire::Body::Pose:
      take_pose(viewer, packet, now_ns);
      break;
    case wire::Body::Probe:
      take_probe(peer, viewer, *root.body_as_Probe(), now_ns);
      break;
    case wire::Body::Quality:
      if (std::erase(viewer.compared, root.body_as_Quality()->probe_id()) > 0) {
        events_.quality(viewer.name, *root.body_as_Quality());
      } else {
        ++ignored_;
      }
      break;
    case wire::Body::Held:
      if (packet.stream_epoch() == model_.status().epoch) take_held(viewer, *root.body_as_Held(), now_ns);
      break;
    case wire::Body::Bye:
      say(fmt::format("viewer {} left", viewer.name));
      remember(peer, viewer, now_ns);
      viewers_.erase(found);
      if (viewers_.empty()) empty_since_ns_ = now_ns;
      break;
    default:
      ++ignored_;
  }
}

// The newest of a burst is passed on.
void ViewerHub::take_pose(Viewer& viewer, const stream::ParsedPacket& packet, std::int64_t now_ns) {
  viewer.gaze.add(from_wire(*packet.root().body_as_Pose()->camera()), now_ns);
  viewer.pose = packet;
}

void ViewerHub::pass_pose(Viewer& viewer, std::int64_t now_ns) {
  if (!viewer.pose || now_ns - viewer.posed_ns < kPoseEveryNs) return;
  viewer.posed_ns = now_ns;
  if (viewer.rights.steer) events_.pose(viewer.name, *viewer.pose->root().body_as_Pose());
  viewer.pose.reset();
}

void ViewerHub::take_probe(const Endpoint::Peer& peer, Viewer& viewer, const wire::Probe& probe, std::int64_t now_ns) {
  const Camera camera = from_wire(*probe.camera());  // refuses what makes no sense
  if (!is_probe_size(camera.width, camera.height)) {
    throw std::runtime_error(fmt::format("camera: {} x {} pixels, where a probe has {} at most", camera.width,
                                         camera.height, kMaxProbePixels));
  }
  std::erase_if(probes_, [&](const auto& entry) { return now_ns - entry.second.asked_ns > kProbeNs; });
  const auto of_one = std::ranges::count_if(probes_, [&](const auto& entry) { return entry.second.asker == peer; });
  const bool room = probes_.size() < kProbesInFlight && static_cast<std::size_t>(of_one) < kProbesOfOne;
  if (!viewer.rights.probe || !room || !probes_.try_emplace(probe.probe_id(), Probe{peer, now_ns}).second) {
    ++ignored_;
    return;
  }
  events_.probe(viewer.name, probe);
}

void ViewerHub::take_held(Viewer& viewer, const wire::Held& held, std::int64_t now_ns) {
  ViewerFeed::Said said{.newest = held.newest(),
                        .missing = {},
                        .lacks = {},
                        .dropped = {},
                        .most_kbps = static_cast<double>(held.max_kbps())};
  if (held.missing()) {
    for (const wire::SequenceRange* range : *held.missing()) said.missing.push_back({range->first(), range->last()});
  }
  if (held.lacks()) {
    for (const wire::PageVersion* page : *held.lacks()) said.lacks.push_back({page->page(), page->version()});
  }
  if (held.dropped()) said.dropped.assign(held.dropped()->begin(), held.dropped()->end());
  const bool anew = viewer.feed.acknowledge(said, model_, now_ns);
  if (anew) {
    begin(viewer, false);
  } else if (held.scene_lost()) {
    if (SharedPacket scene = whole_scene()) {
      viewer.feed.drop_scenes();
      viewer.feed.push_scene(std::move(scene));
    }
  }
}

void ViewerHub::take_page_request(const Endpoint::Received& received, std::int64_t now_ns) {
  const auto& [peer, packet, rights, address, is_service] = received;
  const wire::PageRequest& request = *packet.root().body_as_PageRequest();
  const std::size_t pages = request.pages() ? request.pages()->size() : 0;
  const double manifest = request.manifest() ? PageReaders::price_of_manifest(board_.offered().size()) : 0;
  const auto wanted = static_cast<double>(pages) + manifest;
  const bool is_reader = is_service && rights.control;
  if (is_reader ? !readers_.take(peer, wanted, now_ns)
                : pages > PageReaders::kStrangersBurst || !readers_.take_as_stranger(address, wanted, now_ns)) {
    ++ignored_;
    return;
  }
  if (!model_.status().ready) return;
  PageAnswers::Request asked{
      .manifest = request.manifest(), .pages = {}, .epoch = packet.stream_epoch(), .is_stranger = !is_reader};
  for (std::size_t k = 0; k < pages; ++k) {
    const wire::PageVersion* page = request.pages()->Get(static_cast<flatbuffers::uoffset_t>(k));
    asked.pages.push_back({page->page(), page->version()});
  }
  if (!answers_.take(peer, asked, now_ns)) ++ignored_;
}

std::string ViewerHub::refusal_of(const std::string& address) const {
  if (viewers_.size() >= options_.max_viewers)
    return fmt::format("no more than {} viewers are served", viewers_.size());
  if (address.empty()) return {};
  const auto its = static_cast<std::size_t>(
      std::ranges::count_if(viewers_, [&](const auto& entry) { return entry.second.address == address; }));
  if (its < options_.max_viewers_per_address) return {};
  return fmt::format("no more than {} viewers are served at one address", its);
}

void ViewerHub::hello(const Endpoint::Received& received, std::int64_t now_ns) {
  const auto& [peer, packet, rights, address, is_service] = received;
  const wire::Hello& body = *packet.root().body_as_Hello();
  if (const std::string refusal = refusal_of(address); !refusal.empty()) {
    send(peer, WirePacket(writer_.write(model_.status().epoch, 0, wire::Body::Bye, [&](auto& builder) {
           return wire::CreateByeDirect(builder, refusal.c_str());
         })));
    return;
  }
  // What makes no sense is refused before anything is taken: who left would else come back without its debts.
  std::optional<Camera> camera;
  if (body.camera()) camera = from_wire(*body.camera());
  Viewer viewer(body.max_gaussians() != 0 ? body.max_gaussians() : stream::kMaxGaussians);
  viewer.name = bus::printable(body.viewer()->string_view());
  viewer.address = address;
  viewer.rights = rights;
  if (auto before = book_.take_leaver(peer, address, viewer.name, now_ns)) {
    viewer.limits = before->limits;
    viewer.posed_ns = before->posed_ns;
    viewer.feed.rate().begin_with(std::move(before->spent));
  }
  viewer.connection = ++connections_;
  viewer.wants_probes = body.probes();
  viewer.heard_ns = viewer.sent_ns = now_ns;
  if (camera) viewer.gaze.add(*camera, now_ns);
  viewer.feed.want(body.max_kbps());
  const stream::StreamModel::Status held = model_.status();
  const bool same = held.ready && packet.stream_epoch() == held.epoch;
  if (same && body.held()) {
    std::vector<stream::PageVersion> pages;
    std::vector<std::uint32_t> gone;
    for (const wire::PageVersion* page : *body.held()) {
      if (board_.find(page->page())) {
        pages.push_back({page->page(), page->version()});
      } else {
        gone.push_back(page->page());
      }
    }
    // Which pages of a version one was not sent its lights for only the streamer before knew.
    const bool is_current = body.visibility_version() == board_.visibility_version() && held.epoch != epoch_of_before_;
    viewer.feed.resume(board_, pages, is_current);
    viewer.feed.tell_gone(model_, std::move(gone));
  }
  say(fmt::format("viewer {} {}", viewer.name, same ? "is back" : "joined"));
  statistics_.begin(now_ns);
  send(peer, WirePacket(welcome(viewer.connection)));
  set_rate(viewer.feed, now_ns);
  if (held.ready) begin(viewer, same && body.scene_version() == model_.scene_version());
  viewers_.insert_or_assign(peer, std::move(viewer));
}

}  // namespace splatbus::streamer
