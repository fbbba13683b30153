#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "bus/log_sink.h"
#include "gaussians/camera.h"
#include "stream/stream_model.h"
#include "streamer/endpoint.h"
#include "streamer/packet_feed.h"
#include "streamer/wire_statistics.h"

namespace splatbus::streamer {

struct HubOptions {
  std::size_t max_viewers = 64;
  std::size_t history_bytes = std::size_t{16} << 20;
  double viewer_timeout_s = 5;  ///< a viewer that sends nothing, or reads nothing, for so long is forgotten
  float tick_hz = 5;
};

/// What viewers ask of the rest of the system.
struct HubEvents {
  std::function<void(const std::string& viewer, const wire::Pose&)> pose;
  std::function<void(const std::string& viewer, const wire::Probe&)> probe;
  std::function<void(const std::string& viewer, const wire::Quality&)> quality;
};

/// Where every viewer is in the stream. Each is sent, in this order and as fast as it reads: what it asked to be
/// resent, the chunks of its snapshot, the broadcast packets that follow it, the newest few probe pictures. Nothing is
/// queued for a viewer but numbers and shared packets: memory does not grow with a viewer that does not read. One
/// thread.
class ViewerHub {
 public:
  ViewerHub(Endpoint& endpoint, stream::StreamModel& model, stream::PacketWriter writer, HubOptions options,
            HubEvents events);

  /// Takes what viewers sent. Bounded work a call.
  void receive(std::int64_t now_ns);
  /// After a tick of the model.
  void broadcast(const std::vector<stream::EncodedPacket>& packets);
  /// After the model was reset: everybody starts over with a snapshot.
  void restart_all();
  /// Sends as much as sockets take. True when somebody's is full.
  /// `settled`: the model is not being ticked, so that snapshots may begin.
  bool pump(std::int64_t now_ns, bool settled = true);
  /// Once a second: Keepalive to all.
  void send_keepalive();
  /// Forgets viewers that fell silent.
  void expire(std::int64_t now_ns);
  /// To every viewer that wants probe pictures, and to the one that asked for this probe: by pump(), behind the model.
  void send_probe_picture(std::uint64_t probe_id, const stream::EncodedPacket& picture);

  [[nodiscard]] std::size_t viewers() const { return viewers_.size(); }
  /// False while nobody holds or awaits anything of the current epoch: then the model may be reset.
  [[nodiscard]] bool anybody_follows() const;
  [[nodiscard]] std::vector<Camera> cameras() const;

  [[nodiscard]] WireStatistics& statistics() { return statistics_; }
  [[nodiscard]] std::uint64_t snapshots() const { return feed_.snapshots(); }
  [[nodiscard]] std::uint64_t resends() const { return feed_.resends(); }
  [[nodiscard]] std::uint64_t lost_viewers() const { return lost_viewers_; }

 private:
  struct Viewer {
    std::string name;
    std::optional<Camera> camera;
    bool wants_probes = false;
    std::int64_t heard_ns = 0, sent_ns = 0;
    StreamCursor cursor;
    std::deque<SharedPacket> pictures;
  };

  void handle(const Endpoint::Received& received, std::int64_t now_ns);
  void hello(const Endpoint::Peer& peer, const stream::ParsedPacket& packet, std::int64_t now_ns);
  /// Next packet to send to a viewer, null when there is none; and what to do when it is sent.
  [[nodiscard]] SharedPacket next_packet(Viewer& viewer, std::int64_t now_ns, bool settled);
  void advance(Viewer& viewer, const SharedPacket& sent);
  Endpoint::Sent send(const Endpoint::Peer& peer, const WirePacket& packet);
  [[nodiscard]] stream::EncodedPacket welcome(bool asks) const;

  Endpoint& endpoint_;
  stream::StreamModel& model_;
  stream::PacketWriter writer_;
  HubOptions options_;
  HubEvents events_;
  std::map<Endpoint::Peer, Viewer> viewers_;
  PacketFeed feed_;
  std::map<std::uint64_t, Endpoint::Peer> probe_askers_;
  WireStatistics statistics_;
  std::uint64_t lost_viewers_ = 0;
  bus::LogLimiter log_limiter_;
};

}  // namespace splatbus::streamer
