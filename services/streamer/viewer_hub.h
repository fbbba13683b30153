#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "bus/log_sink.h"
#include "gaussians/camera.h"
#include "stream/stream_model.h"
#include "streamer/endpoint.h"
#include "streamer/page_answers.h"
#include "streamer/page_board.h"
#include "streamer/page_readers.h"
#include "streamer/peer_book.h"
#include "streamer/peer_limits.h"
#include "streamer/viewer_feed.h"
#include "streamer/wire_statistics.h"

namespace splatbus::streamer {

struct HubOptions {
  std::size_t max_viewers = 64;
  std::size_t max_viewers_per_address = 56;  ///< leaves others a few; not of own processes
  std::size_t history_bytes = std::size_t{16} << 20;
  double viewer_timeout_s = 5;  ///< a viewer that sends nothing, or reads nothing, for so long is forgotten
  float tick_hz = 5;
  double viewer_kbps = 9000;  ///< to one viewer; 0: found out
  double join_kbps = 0;       ///< to one that has not been whole yet, where that is more
};

/// What viewers ask of the rest of the system.
struct HubEvents {
  std::function<void(const std::string& viewer, const wire::Pose&)> pose;
  std::function<void(const std::string& viewer, const wire::Probe&)> probe;
  std::function<void(const std::string& viewer, const wire::Quality&)> quality;
};

/// All viewers. Each is sent what its feed chooses, as fast as it reads and at most at its rate, and the newest few
/// probe pictures. Nothing is queued for a viewer but numbers and shared packets: memory does not grow with a viewer
/// that does not read, and nobody waits for another. What viewers say is bounded by kind and peer. One thread.
class ViewerHub {
 public:
  static constexpr std::size_t kProbesInFlight = 64, kProbesOfOne = 8;

  ViewerHub(Endpoint& endpoint, stream::StreamModel& model, stream::PacketWriter writer, HubOptions options,
            HubEvents events);

  /// Takes what viewers sent. Bounded work a call.
  void receive(std::int64_t now_ns);
  /// After a tick of the model.
  void add(stream::StreamUpdate update) { add(std::move(update), {.all = model_.offered(), .of_others = {}}); }
  /// After ticks of this and of other replicas.
  void add(stream::StreamUpdate update, BoardPages pages);
  /// The scene that take_scene() gave, for everybody.
  void add_scene(const stream::EncodedPacket& packet);
  /// Where they are: what viewers see of pages in their frames.
  void set_objects(const ObjectTransforms& objects) { objects_ = objects; }
  void add_visibility(std::vector<stream::VisibilityPacket> packets);
  /// After the model was reset: everybody starts over.
  void restart_all() { restart_all({.all = model_.offered(), .of_others = {}}); }
  void restart_all(BoardPages pages);

  // What replicas do for each other.
  /// Visibility of others' pages under `scene`, the newest that viewers are sent.
  void add_others_visibility(std::vector<stream::VisibilityPacket> packets, const SceneState& scene);
  /// Others' pages that were wanted.
  void take(ShareAnswer answer) { board_.take(std::move(answer)); }
  [[nodiscard]] std::vector<ShareWant> take_wants(std::int64_t now_ns) { return board_.take_wants(now_ns); }
  /// For another replica; nullopt for what is not encoded here.
  [[nodiscard]] std::optional<ShareAnswer> answer(const ShareWant& want);
  /// Sends as much as sockets and rates take. True when somebody waits for either.
  bool pump(std::int64_t now_ns);
  /// Once a second: Keepalive to all.
  void send_keepalive(std::int64_t now_ns);
  /// Forgets viewers that fell silent.
  void expire(std::int64_t now_ns);
  /// To the viewer that asked for this probe; where somebody else did, to every viewer that wants probe pictures: by
  /// pump(), behind the model.
  void send_probe_picture(std::uint64_t probe_id, const stream::EncodedPacket& picture);
  void set_rates(double viewer_kbps, double join_kbps) {
    options_.viewer_kbps = viewer_kbps;
    options_.join_kbps = join_kbps;
  }

  /// The most that any viewer has room for in deltas; nullopt without viewers.
  [[nodiscard]] std::optional<double> delta_bytes_per_s() const;
  [[nodiscard]] std::size_t viewers() const { return viewers_.size(); }
  /// Whether anybody is sent anything of the model: a viewer, or one who asks for pages.
  [[nodiscard]] bool is_followed() const { return !viewers_.empty() || !readers_.empty(); }
  /// Viewers of the streamer before are on their way: that nobody is here counts from now on.
  void await_viewers_of_before(std::int64_t now_ns) {
    empty_since_ns_ = now_ns;
    epoch_of_before_ = model_.status().epoch;
  }
  /// How long nobody has been here; 0 while somebody is.
  [[nodiscard]] double empty_s(std::int64_t now_ns) const;
  /// Of some viewers, in turn: what they see comes first in a tick.
  [[nodiscard]] std::vector<Camera> cameras();
  /// Pages that anybody holds and follows by deltas.
  [[nodiscard]] std::set<std::uint32_t> followed_pages() const;

  /// Gaussians and pages that viewers may have.
  [[nodiscard]] std::size_t gaussians() const { return board_.gaussians().value_or(model_.status().gaussians); }
  [[nodiscard]] std::size_t pages() const {
    return board_.gaussians() ? board_.offered().size() : model_.status().pages;
  }
  [[nodiscard]] WireStatistics& statistics() { return statistics_; }
  struct Counts {
    std::uint64_t whole_pages = 0, lost_packets = 0, refused_pages = 0;
  };
  [[nodiscard]] Counts counts() const;
  [[nodiscard]] std::uint64_t lost_viewers() const { return lost_viewers_; }
  /// What viewers said too often.
  [[nodiscard]] std::uint64_t ignored() const { return ignored_; }

 private:
  struct Viewer {
    explicit Viewer(std::size_t max_gaussians) : feed(max_gaussians) {}

    std::string name, address;
    bus::Rights rights;
    std::uint64_t connection = 0;
    GazeTracker gaze;
    bool wants_probes = false;
    std::int64_t heard_ns = 0, sent_ns = 0, posed_ns = 0;
    std::optional<stream::ParsedPacket> pose;  ///< newest, that the rest has not heard
    PeerLimits limits;
    ViewerFeed feed;
    std::deque<SharedPacket> pictures;
    std::deque<std::uint64_t> compared;  ///< probes whose pictures it was sent
  };
  struct Probe {
    Endpoint::Peer asker;
    std::int64_t asked_ns = 0;
  };

  void handle(const Endpoint::Received& received, std::int64_t now_ns);
  void hello(const Endpoint::Received& received, std::int64_t now_ns);
  void take_pose(Viewer& viewer, const stream::ParsedPacket& packet, std::int64_t now_ns);
  void pass_pose(Viewer& viewer, std::int64_t now_ns);
  void take_probe(const Endpoint::Peer& peer, Viewer& viewer, const wire::Probe& probe, std::int64_t now_ns);
  void take_held(Viewer& viewer, const wire::Held& held, std::int64_t now_ns);
  void take_page_request(const Endpoint::Received& received, std::int64_t now_ns);
  void begin(Viewer& viewer, bool has_scene);
  [[nodiscard]] SharedPacket whole_scene();
  /// Why somebody of that address may not be a viewer; empty: it may.
  [[nodiscard]] std::string refusal_of(const std::string& address) const;
  /// What is kept of it, when it goes.
  void remember(const Endpoint::Peer& peer, const Viewer& viewer, std::int64_t now_ns);
  void set_rate(ViewerFeed& feed, std::int64_t now_ns) const;
  Endpoint::Sent send_next(const Endpoint::Peer& peer, Viewer& viewer, std::int64_t now_ns, bool& idle);
  Endpoint::Sent send(const Endpoint::Peer& peer, const WirePacket& packet, std::uint64_t sequence = 0);
  [[nodiscard]] stream::EncodedPacket welcome(std::uint64_t connection) const;
  void say(const std::string& text);

  Endpoint& endpoint_;
  stream::StreamModel& model_;
  stream::PacketWriter writer_;
  HubOptions options_;
  HubEvents events_;
  std::map<Endpoint::Peer, Viewer> viewers_;
  PageBoard board_;
  PageReaders readers_;
  PageAnswers answers_;
  ObjectTransforms objects_;
  std::map<std::uint64_t, Probe> probes_;
  PeerBook book_;
  struct WholeScene {
    std::uint64_t epoch = 0, version = 0;
    SharedPacket packet;
  };
  WholeScene whole_scene_;  ///< the newest that was asked for
  WireStatistics statistics_;
  Counts former_;  ///< of viewers that are gone
  std::uint64_t lost_viewers_ = 0, ignored_ = 0, camera_turn_ = 0;
  /// Begins where no other process does: who comes from another streamer of the same stream is numbered anew.
  std::uint64_t connections_;
  std::int64_t empty_since_ns_ = 0;
  std::uint64_t epoch_of_before_ = 0;  ///< that was begun by another streamer; 0: none
  bus::LogLimiter log_limiter_;
};

}  // namespace splatbus::streamer
