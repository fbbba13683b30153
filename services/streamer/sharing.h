#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "bus/publisher.h"
#include "bus/token_bucket.h"
#include "stream/streamer_choice.h"
#include "streamer/page_division.h"
#include "streamer/share_message.h"
#include "streamer/viewer_hub.h"

namespace splatbus::wire {
struct Liveness;
}  // namespace splatbus::wire

namespace splatbus::streamer {

/// What of a tick depends on other replicas. Without any it is as it comes.
struct TickShare {
  std::shared_ptr<const EncodedPages> pages;   ///< null: all
  std::optional<stream::StreamOrigin> origin;  ///< of the stream that this one goes over to, before the tick
  std::uint32_t raise_version = 0;
};

/// This replica of the streamer among the others of its bus. Each page is encoded by one of them, and its packets go to
/// the viewers of all (stream/share). All are in one stream, that of the lowest epoch. Who encodes a page is told by
/// rendezvous hashing over those that are heard; but one that has encoded a page goes on until the other one has it. Of
/// what a peer says nothing is believed that read_share() does not check; what it may bring about is bounded. One
/// thread; times are CLOCK_MONOTONIC.
class Sharing {
 public:
  /// All of them outlive this. `others`: the streamers that say where they are.
  Sharing(std::string own, const bus::Publisher& publisher, stream::StreamModel& model, ViewerHub& hub,
          const stream::StreamerChoice& others, double tick_hz);

  /// What another streamer says, in its own words of stream/share. Throws as read_share() does.
  void take(const wire::StreamShare& body, std::int64_t now_ns);
  void take(const wire::Liveness& liveness);
  /// Viewers' newest scene.
  void set_scene(const SceneState& scene) { scene_ = scene; }
  void drain() { draining_ = true; }

  /// Whether there are others, so that ticks are worth beginning together.
  [[nodiscard]] bool active() const { return !peers_.empty(); }
  /// Whether all that viewers are sent is encoded here.
  [[nodiscard]] bool has_all() const { return peers_.empty() && inherited_.empty() && division_.sources().size() == 1; }
  /// The largest that anybody has used in the stream.
  [[nodiscard]] std::uint32_t newest_version() const { return place().version; }
  /// False for a moment after the start while others may be about to say in which stream they are.
  [[nodiscard]] bool may_begin(std::int64_t now_ns);
  /// Whether anybody is sent anything of the model by another one.
  [[nodiscard]] bool others_are_followed() const;

  // Before a tick, what is here and there.
  [[nodiscard]] TickShare begin_tick(std::int64_t now_ns);
  [[nodiscard]] std::set<std::uint32_t> holders(std::int64_t now_ns);
  [[nodiscard]] std::vector<Camera> cameras();
  [[nodiscard]] std::optional<double> delta_bytes_per_s();

  /// After a tick: others are told.
  void end_tick(stream::StreamUpdate update, std::int64_t now_ns);
  /// After the model was reset, in place of end_tick().
  void restart(std::int64_t now_ns);
  /// What is to go to viewers now: at once where nobody shares, otherwise once all have ticked, so that viewers are
  /// planned for once, or a quarter of a tick after the first.
  [[nodiscard]] std::optional<stream::StreamUpdate> take_due(std::int64_t now_ns);
  /// When that is; nullopt: nothing waits.
  [[nodiscard]] std::optional<std::int64_t> due_ns() const;
  [[nodiscard]] BoardPages pages() const;

  void publish_visibility(const std::vector<stream::VisibilityPacket>& packets);
  /// Asks for what viewers need of others.
  void publish_wants(std::int64_t now_ns);
  /// At least so often, also while nothing ticks.
  void publish_still(std::int64_t now_ns);

  [[nodiscard]] std::size_t replicas() const { return division_.sources().size(); }

  static constexpr std::size_t kMaxPeers = 64;
  static constexpr std::int64_t kSilentNs = 3'000'000'000;  ///< then a peer is gone

 private:
  struct Peer {
    std::uint64_t incarnation = 0;  ///< its process's epoch
    ShareMessage::Place before;     ///< of the one before it under this name: it offers nothing that may be that one's
    ShareMessage::Place place;
    ShareMessage::Viewers viewers;
    std::vector<stream::OfferedPage> pages;
    bool told = false;    ///< its pages
    bool reuses = false;  ///< versions of the one before, for some of them
    bool alive = true;    ///< as the broker sees it
    bool ticked = false;
    std::int64_t heard_ns = 0;
    bus::TokenBucket answers{1000, 1000};
  };
  using Peers = std::map<std::string, Peer>;

  [[nodiscard]] bool publishes() const;
  [[nodiscard]] static bool same_stream(const ShareMessage::Place& a, const ShareMessage::Place& b);
  [[nodiscard]] ShareMessage::Place place() const;
  /// Whether its packets are of the stream that viewers here are sent.
  [[nodiscard]] bool in_stream(const Peer& peer) const { return same_stream(peer.place, place_); }
  [[nodiscard]] bool encodes(const Peer& peer) const {
    return peer.alive && peer.place.encodes && same_stream(peer.place, goal_);
  }
  /// A name's process that others have not heard of begins with nothing of the one before.
  Peer& heard(const std::string& source, std::uint64_t incarnation);
  static void leave_out_before(Peer& peer, ShareMessage& message);
  void forget_silent(std::int64_t now_ns);
  /// Viewers keep its pages until a tick has made them anew.
  void inherit_pages(const Peer& peer);
  [[nodiscard]] const Peer* to_join() const;
  [[nodiscard]] std::uint32_t version_floor() const;
  /// Whether versions run out there.
  [[nodiscard]] static bool is_spent(const ShareMessage::Place& place);
  [[nodiscard]] bool divide();
  [[nodiscard]] bool leave_pages(EncodedPages& pages) const;
  void take_deltas(std::vector<stream::DeltaPacket> deltas, std::int64_t now_ns);
  void answer(Peer& peer, const std::vector<ShareWant>& wants, std::int64_t now_ns);
  void contribute(std::int64_t now_ns);
  /// `deltas` are as before afterwards.
  void publish_tick(std::vector<stream::DeltaPacket>& deltas, std::int64_t now_ns);
  void publish(const ShareMessage& message) const;

  std::string own_;
  const bus::Publisher& publisher_;
  stream::StreamModel& model_;
  ViewerHub& hub_;
  const stream::StreamerChoice& others_;
  std::int64_t patience_ns_;
  SceneState scene_;
  Peers peers_;
  struct Inherited {
    stream::OfferedPage page;
    std::optional<std::int64_t> tick_ns;  ///< when the first tick since began, which makes it anew if it is one's own
  };
  std::map<std::uint32_t, Inherited> inherited_;  ///< pages of those that are gone, by number
  ShareMessage::Place place_;                     ///< that viewers are sent: as after the last tick
  ShareMessage::Place goal_;                      ///< that the tick is for: another one where it goes over to a peer's
  PageDivision division_;
  stream::StreamUpdate pending_;
  std::optional<std::int64_t> pending_since_ns_;
  bool ticked_ = false, draining_ = false;
  std::uint32_t newest_ = 0;                        ///< version that anybody has said in the stream newest_of_
  std::uint64_t newest_of_ = 0;                     ///< its epoch
  std::set<std::string> known_;                     ///< others, also those that are silent but not known to be dead
  std::map<std::uint32_t, std::int64_t> given_ns_;  ///< pages that others were given, and when
  std::shared_ptr<const std::vector<stream::OfferedPage>> told_;
  std::int64_t told_ns_ = 0, started_ns_ = 0, published_ns_ = 0;
  std::size_t camera_turn_ = 0;
  ShareMessage::Viewers viewers_;  ///< here, as the last tick began
};

}  // namespace splatbus::streamer
