#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>

#include "bus/clock.h"
#include "bus/log_sink.h"
#include "gaussians/camera.h"
#include "metrics/metrics.h"
#include "stream/follower.h"
#include "stream/packet_log.h"
#include "viewer/packet_link.h"

namespace splatbus::viewer {

struct ClientOptions {
  std::string endpoint;  ///< of ZeroMQ; or a gateway's address: ws://, wss://, http:// or https://
  /// Where the streamer is now: asked several times a second by whoever polls. Another answer than before, that is not
  /// empty: the viewer goes there. Null: `endpoint` it is.
  std::function<std::string()> find_endpoint;
  std::string name;
  std::string key, server_key;                        ///< for a streamer elsewhere: as bus::client_keys() has them
  std::string token, ca;                              ///< for a gateway: as WebLinkOptions has them
  bool probes = false;                                ///< wants ProbePictures; else they are ignored
  std::size_t max_gaussians = stream::kMaxGaussians;  ///< that are held
  std::uint32_t max_kbps = 0;                         ///< that it wants to be sent; 0: as the streamer likes
  std::int64_t hello_every_ns = 200'000'000;
  std::int64_t silence_ns = 3'000'000'000;   ///< after that the streamer is taken for gone, and greeted again
  std::int64_t pose_every_ns = 100'000'000;  ///< at most, while the camera moves; a tenth as often while it rests
  std::function<std::int64_t()> now_ns = bus::now_ns;
  std::string packet_log;  ///< what is received is written there (stream/packet_log.h); empty: it is not
  std::size_t held_picture_bytes = std::size_t{1} << 28;  ///< of answers that nobody took yet; more are not kept
};

using stream::ProbeAnswer;

/// A Follower of the streamer at a ZeroMQ endpoint, or behind a gateway. Needs no bus. One thread.
class StreamClient {
 public:
  /// Connects; the streamer may start later. Throws bus::Error naming the endpoint, or the log.
  explicit StreamClient(ClientOptions options);

  /// Waits up to `timeout` for packets, or until the descriptor `wake` (-1: none) can be read; takes all that are
  /// there, and sends what is due. True when the picture may have changed.
  bool poll(std::chrono::milliseconds timeout, int wake = -1);

  /// Of every picture; it is sent as often as the options say.
  void send_pose(const Camera& camera) { follower_.set_camera(camera); }
  void send_probe(std::uint64_t probe_id, const Camera& camera);
  void send_quality(std::uint64_t probe_id, const metrics::Quality& quality, std::int64_t first_picture_ns);

  /// Others than the options'. True when the model is asked for anew, since it is to have another size: replica() is
  /// another one, and nobody observes it. Where there is no way to do so that is logged, and the size stays.
  bool set_budget(std::size_t max_gaussians, std::uint32_t max_kbps);
  [[nodiscard]] std::optional<double> round_trip_ms() const { return link_->round_trip_ms(); }

  // The follower's.
  [[nodiscard]] const stream::Replica& replica() const { return follower_.replica(); }
  [[nodiscard]] stream::Replica& replica() { return follower_.replica(); }
  [[nodiscard]] stream::DisplayChanges take_changes() { return follower_.replica().take_changes(); }
  [[nodiscard]] std::optional<ProbeAnswer> take_probe_answer() { return follower_.take_probe_answer(); }
  [[nodiscard]] bool connected() const { return follower_.connected(); }
  [[nodiscard]] std::uint64_t received_bytes() const { return before_.received_bytes + follower_.received_bytes(); }
  [[nodiscard]] std::uint64_t refused() const { return before_.refused + follower_.refused(); }
  [[nodiscard]] std::uint64_t lost() const { return before_.lost + follower_.lost(); }
  [[nodiscard]] std::uint64_t lacked() const { return before_.lacked + follower_.lacked(); }
  [[nodiscard]] const stream::SceneDelays& scene_delays() const { return follower_.scene_delays(); }

  /// For tests: a packet for which it returns true is lost on the way.
  void lose_packets(std::function<bool(const stream::ParsedPacket&)> lose) { lose_ = std::move(lose); }

  ~StreamClient();
  StreamClient(const StreamClient&) = delete;
  StreamClient& operator=(const StreamClient&) = delete;

 private:
  [[nodiscard]] stream::Follower make_follower() const;
  void follow_streamer();
  bool receive_all();
  bool receive(std::span<const std::uint8_t> packet, std::span<const std::uint8_t> payload);
  void send_all();
  void send(const stream::EncodedPacket& packet);

  struct Totals {
    std::uint64_t received_bytes = 0, refused = 0, lost = 0, lacked = 0;
  };

  ClientOptions options_;
  Totals before_;  ///< of the followers before: counters never go backwards
  std::unique_ptr<PacketLink> link_;
  stream::Follower follower_;
  std::optional<stream::PacketLog> packet_log_;
  std::function<bool(const stream::ParsedPacket&)> lose_;
  std::string last_refusal_;
  std::int64_t next_find_ns_ = 0;
  bus::LogLimiter log_limiter_;
};

}  // namespace splatbus::viewer
