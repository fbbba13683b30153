#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <exception>
#include <functional>
#include <future>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>
#include <tuple>
#include <vector>

#include "bus/file_descriptor.h"
#include "viewer/row_feed.h"
#include "viewer/shown.h"
#include "viewer/stream_client.h"

namespace splatbus::viewer {

/// Of a client, a moment ago.
struct ReceiverStatus {
  bool connected = false;
  std::size_t pages = 0, missing_pages = 0;  ///< that there are; that are not held
  std::uint64_t received_bytes = 0, refused = 0, lost = 0, lacked = 0;
  std::size_t scene_delays = 0;  ///< that were measured
  double scene_delay_ms_p50 = 0, scene_delay_ms_p99 = 0;
  std::optional<double> round_trip_ms;
};

/// What was shown at one instant.
struct ShownModel {
  stream::DisplayChanges changes;  ///< for a fresh stream::DisplayGaussians
  SceneState scene;
};

/// A StreamClient on a thread of its own, so that what arrives is held, and what is missing asked for, however long a
/// picture takes. Another thread shows it: all that take() gives at once is of one state of the replica. No call waits
/// for a packet to be decoded.
class StreamReceiver {
 public:
  enum class Gives { Changes, Rows };
  /// `gives`: Shown::changes, or Shown::batches. Throws as StreamClient.
  explicit StreamReceiver(ClientOptions options, Gives gives = Gives::Changes);
  ~StreamReceiver();
  StreamReceiver(const StreamReceiver&) = delete;
  StreamReceiver& operator=(const StreamReceiver&) = delete;

  /// False, with nothing in it, when the picture is as it was. Throws what has ended the thread.
  [[nodiscard]] bool take(Shown& shown);
  /// Until take() has something, or with `answers` take_probe_answer().
  void wait_for(std::chrono::nanoseconds timeout, bool answers = true);

  /// Of the fades of Shown::batches.
  [[nodiscard]] float fade_time_s(std::int64_t now_ns) const {
    return 1 + static_cast<float>(static_cast<double>(now_ns - begin_ns_) / 1e9);
  }

  void send_pose(const Camera& camera);
  void send_probe(std::uint64_t probe_id, const Camera& camera);
  void send_quality(std::uint64_t probe_id, const metrics::Quality& quality, std::int64_t first_picture_ns);
  [[nodiscard]] std::optional<ProbeAnswer> take_probe_answer();
  [[nodiscard]] ReceiverStatus status() const;
  /// As StreamClient's. What is shown stays until most of the model of another size is there, a few seconds at most.
  void set_budget(std::size_t max_gaussians, std::uint32_t max_kbps);
  /// Shown::batches begin anew, with a whole one; for a painter that has nothing yet.
  void give_all();
  /// Of a model that is not here yet it is a std::runtime_error.
  [[nodiscard]] std::future<ShownModel> copy_model();

 private:
  void run();
  void post(std::function<void(StreamClient&)> action);
  void wake();
  void do_posted();
  void hand_over(bool changed);
  /// The model was asked for anew while another one is shown.
  struct Renewal {
    std::size_t enough = 0;     ///< Gaussians that may take its place
    std::int64_t until_ns = 0;  ///< from then on any may; 0 until there are some
  };
  [[nodiscard]] bool replaces(const Renewal& renewal) const;
  [[nodiscard]] ReceiverStatus measure();

  using SceneKey = std::tuple<std::uint64_t, std::uint64_t, std::uint64_t>;  // epoch, version, frame
  StreamClient client_;                                                      // the thread's own
  std::int64_t begin_ns_;
  std::optional<RowFeed> feed_;    // too
  SceneKey scene_key_{};           // too
  std::int64_t measured_ns_ = 0;   // too
  std::optional<Renewal> renews_;  // too
  bool all_due_ = false;           // too
  bus::FileDescriptor wake_;

  mutable std::mutex mutex_;  // of all below
  std::condition_variable arrived_;
  bool stop_ = false, changed_ = false;
  Shown shown_;
  std::size_t batch_rows_ = 0;  ///< of shown_
  std::optional<ProbeAnswer> answer_;
  std::vector<std::function<void(StreamClient&)>> posted_;
  ReceiverStatus status_;
  std::exception_ptr failure_;

  std::thread thread_;  // last: it uses all of it
};

}  // namespace splatbus::viewer
