#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "gaussians/camera.h"
#include "gaussians/light.h"
#include "stream/packets.h"
#include "stream/replica.h"
#include "stream/scene_delay.h"

namespace splatbus::stream {

struct FollowerOptions {
  std::string name;
  bool probes = false;      ///< wants ProbePictures that others ask for
  bool own_probes = false;  ///< asks for some itself; where neither is set they are ignored
  std::int64_t hello_every_ns = 200'000'000;
  std::int64_t silence_ns = 3'000'000'000;   ///< after that the streamer is taken for gone, and greeted again
  std::int64_t pose_every_ns = 100'000'000;  ///< at most, while the camera moves; a tenth as often while it rests
  std::size_t max_gaussians = kMaxGaussians;
  std::uint32_t max_kbps = 0;                             ///< that it wants to be sent; 0: as the streamer likes
  std::size_t held_picture_bytes = std::size_t{1} << 28;  ///< of answers that nobody took yet; more are not kept
};

/// The engine's render for a probe.
struct ProbeAnswer {
  std::uint64_t probe_id = 0;
  Camera camera;
  SceneState scene;
  std::int64_t capture_ns = 0;     ///< by the engine's clock; 0: nobody knows
  std::int64_t arrived_ns = 0;     ///< by the clock of receive()
  std::vector<std::uint8_t> rgba;  ///< [height][width][4]
};

/// A viewer's part in the stream's protocol, without a transport and without a clock: keeps a replica, says what of it
/// is missing and where its camera is, and greets a streamer that came back. What is held stays whatever happens to the
/// streamer. Times are of any steady clock, nanoseconds. One thread.
class Follower {
 public:
  explicit Follower(FollowerOptions options, std::int64_t now_ns);

  /// One message of the streamer. True when the picture may have changed. Throws std::runtime_error (StreamError) for
  /// one that is wrong; it has changed nothing then, and the stream goes on.
  bool receive(std::span<const std::uint8_t> packet, std::span<const std::uint8_t> payload, std::int64_t now_ns);

  /// What is to be sent next, nullopt when nothing is due. A packet that the transport cannot take is dropped: what
  /// matters is repeated.
  [[nodiscard]] std::optional<EncodedPacket> next_outgoing(std::int64_t now_ns);

  /// To be called for every picture: the streamer is told as often as the options say.
  void set_camera(const Camera& camera) {
    camera_ = camera;
    pose_is_new_ = true;
  }
  /// Another bound than the options'; the streamer hears of it with the next Held.
  void set_max_kbps(std::uint32_t kbps) { options_.max_kbps = kbps; }
  /// Queues a packet of another kind; `build` as PacketWriter::write takes it.
  template <class Build>
  void say(wire::Body body, Build&& build) {
    if (outgoing_.size() < kMaxOutgoing) outgoing_.push_back(packet_of(body, std::forward<Build>(build)));
  }
  /// To be sent when the viewer ends.
  [[nodiscard]] EncodedPacket farewell() const;
  /// The transport's connection is another one: the streamer does not know it.
  void restart();

  [[nodiscard]] const Replica& replica() const { return replica_; }
  [[nodiscard]] Replica& replica() { return replica_; }
  /// The oldest picture that was not taken yet.
  [[nodiscard]] std::optional<ProbeAnswer> take_probe_answer();
  /// Something for the log, once.
  [[nodiscard]] std::optional<std::string> take_notice() { return std::exchange(notice_, std::nullopt); }

  [[nodiscard]] bool connected() const { return welcomed_; }
  [[nodiscard]] std::uint64_t received_bytes() const { return received_bytes_; }
  [[nodiscard]] std::uint64_t refused() const { return refused_; }  ///< packets that were wrong
  [[nodiscard]] std::uint64_t lost() const { return lost_; }        ///< packets that did not come
  [[nodiscard]] std::uint64_t lacked() const { return lacked_; }    ///< pages that were asked for again
  /// From header.capture_ns to receive(), of the scenes that carry one and follow another. Means something on the
  /// engine's machine only, with CLOCK_MONOTONIC as clock.
  [[nodiscard]] const SceneDelays& scene_delays() const { return scene_delays_; }

 private:
  static constexpr std::size_t kMaxOutgoing = 64;

  template <class Build>
  [[nodiscard]] EncodedPacket packet_of(wire::Body body, Build&& build) const {
    return writer_.write(replica_.epoch(), 0, body, std::forward<Build>(build));
  }
  bool take(const ParsedPacket& packet, std::int64_t now_ns);
  void take_probe_picture(const ParsedPacket& packet, std::int64_t now_ns);
  /// Queues what is due.
  void maintain(std::int64_t now_ns);
  void hello(std::int64_t now_ns);
  void pose(std::int64_t now_ns);
  void say_held(std::int64_t now_ns);

  FollowerOptions options_;
  PacketWriter writer_;
  Replica replica_;
  SceneDelays scene_delays_;
  std::optional<Camera> camera_, posed_;
  std::deque<EncodedPacket> outgoing_;
  std::deque<ProbeAnswer> answers_;
  std::size_t answer_bytes_ = 0;
  std::optional<std::string> notice_;

  bool welcomed_ = false, pose_is_new_ = false;
  std::optional<std::int64_t> hello_ns_, posed_ns_;
  std::int64_t heard_ns_, said_ns_;
  std::uint64_t said_bytes_ = 0;  ///< received when it was last said what is held
  std::uint64_t received_bytes_ = 0, refused_ = 0, lost_ = 0, lacked_ = 0;
};

}  // namespace splatbus::stream
