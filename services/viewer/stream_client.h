#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <functional>
#include <optional>
#include <string>
#include <vector>
#include <zmq.hpp>

#include "bus/clock.h"
#include "bus/log_sink.h"
#include "gaussians/camera.h"
#include "gaussians/light.h"
#include "metrics/metrics.h"
#include "stream/packets.h"
#include "stream/replica.h"
#include "viewer/scene_delay.h"

namespace splatbus::viewer {

struct ClientOptions {
  std::string endpoint;
  std::string name;
  bool probes = false;                                ///< wants ProbePictures; else they are ignored
  std::size_t max_gaussians = stream::kMaxGaussians;  ///< that are held
  std::int64_t hello_every_ns = 200'000'000;
  std::int64_t silence_ns = 3'000'000'000;  ///< after that the streamer is taken for gone, and greeted again
  std::function<std::int64_t()> now_ns = bus::now_ns;
  std::size_t held_picture_bytes = std::size_t{1} << 28;  ///< of answers that nobody took yet; more are not kept
};

/// The engine's render for a probe.
struct ProbeAnswer {
  std::uint64_t probe_id = 0;
  Camera camera;
  SceneState scene;
  std::vector<std::uint8_t> rgba;  ///< [height][width][4]
};

/// A viewer's end of the stream: keeps a replica, says what of it is missing, greets a streamer that came back.
/// What is held stays whatever happens to the streamer. Needs no bus. One thread.
class StreamClient {
 public:
  /// Connects; the streamer may start later. Throws bus::Error naming the endpoint.
  explicit StreamClient(ClientOptions options);

  /// Waits up to `timeout` for packets, or until the descriptor `wake` (-1: none) can be read; takes all that are
  /// there, and sends what is due. True when the picture may have changed.
  bool poll(std::chrono::milliseconds timeout, int wake = -1);

  void send_pose(const Camera& camera);
  void send_probe(std::uint64_t probe_id, const Camera& camera);
  void send_quality(std::uint64_t probe_id, const metrics::Quality& quality, std::int64_t first_picture_ns);

  /// The oldest picture that was not taken yet.
  [[nodiscard]] std::optional<ProbeAnswer> take_probe_answer();

  [[nodiscard]] const stream::Replica& replica() const { return replica_; }
  /// The replica's.
  [[nodiscard]] stream::DisplayChanges take_changes() { return replica_.take_changes(); }
  [[nodiscard]] bool connected() const { return welcomed_; }
  [[nodiscard]] std::uint64_t received_bytes() const { return received_bytes_; }
  [[nodiscard]] std::uint64_t refused() const { return refused_; }  ///< packets that were wrong
  [[nodiscard]] std::uint64_t lost() const { return lost_; }        ///< packets that did not come
  [[nodiscard]] std::uint64_t lacked() const { return lacked_; }    ///< pages that were asked for again

  /// From header.capture_ns to the replica, of the scenes that carry one and follow another. Means something on the
  /// engine's machine only.
  [[nodiscard]] const SceneDelays& scene_delays() const { return scene_delays_; }

  /// For tests: a packet for which it returns true is lost on the way.
  void lose_packets(std::function<bool(const stream::ParsedPacket&)> lose) { lose_ = std::move(lose); }

  ~StreamClient();
  StreamClient(const StreamClient&) = delete;
  StreamClient& operator=(const StreamClient&) = delete;

 private:
  bool receive_all();
  bool take(const stream::ParsedPacket& packet);
  void take_probe_picture(const stream::ParsedPacket& packet);
  void maintain(std::int64_t now_ns);
  void say_held(std::int64_t now_ns);
  void hello(std::int64_t now_ns);
  template <class Build>
  void send(wire::Body body, Build&& build);

  ClientOptions options_;
  zmq::context_t context_;
  zmq::socket_t socket_;
  stream::PacketWriter writer_;
  stream::Replica replica_;
  SceneDelays scene_delays_;
  std::optional<Camera> camera_;
  std::deque<ProbeAnswer> answers_;
  std::size_t answer_bytes_ = 0;
  std::function<bool(const stream::ParsedPacket&)> lose_;

  bool welcomed_ = false;
  std::int64_t heard_ns_ = 0, hello_ns_ = 0, said_ns_ = 0;
  std::uint64_t said_bytes_ = 0;  ///< received when it was last said what is held
  std::string last_refusal_;
  std::uint64_t received_bytes_ = 0, refused_ = 0, lost_ = 0, lacked_ = 0;
  bus::LogLimiter log_limiter_;
};

}  // namespace splatbus::viewer
