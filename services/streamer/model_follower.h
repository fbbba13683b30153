#pragma once

#include <condition_variable>
#include <cstdint>
#include <exception>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "bus/file_descriptor.h"
#include "bus/subscriber.h"
#include "device/device.h"
#include "gaussians/camera.h"
#include "model/published_model.h"
#include "stream/stream_model.h"
#include "streamer/sharing.h"

namespace splatbus::streamer {

/// Follows the published model and ticks the stream on a thread of its own, so that scenes do not wait behind its
/// encoding. One job at a time: while it is busy() the owner's thread asks the StreamModel for no more than its second
/// thread may.
class ModelFollower {
 public:
  struct Job {
    std::optional<bus::Message> announcement;  ///< model/published that is not open yet
    double budget_bytes = 0;
    std::vector<Camera> cameras;
    std::set<std::uint32_t> holders;  ///< pages that anybody holds and follows by deltas
    std::uint64_t scene_version = 0;  ///< that viewers have been sent, for the trace
    TickShare share;                  ///< of `budget_bytes` it has the part that its Gaussians are of all
  };
  /// After a job.
  struct Result {
    bool opened = false;           ///< a model has been, in this job or before
    bool fresh = false;            ///< it could be observed
    bool restarted = false;        ///< the stream was reset to it: everybody starts over
    std::uint64_t generation = 0;  ///< of what was observed; with `fresh`
    double spent_bytes = 0;        ///< of the job's budget
    double ms = 0, cpu_ms = 0;
    std::size_t observed = 0, unsent = 0, pending_deltas = 0;
    bool full = false;
    std::uint64_t host_copied_bytes = 0, observed_bytes = 0;
    std::string error;  ///< what could not be streamed
  };

  ModelFollower(stream::StreamModel& model, Device device);
  ~ModelFollower();
  ModelFollower(const ModelFollower&) = delete;
  ModelFollower& operator=(const ModelFollower&) = delete;

  /// Asserts that it is not busy.
  void start(Job job);
  /// From start() until take_result() has given its result.
  [[nodiscard]] bool busy() const { return busy_; }
  /// Without waiting. Throws what the device threw.
  [[nodiscard]] std::optional<Result> take_result();
  /// Until there is one.
  void wait();
  /// Can be read when there is one.
  [[nodiscard]] int descriptor() const { return done_event_.get(); }

 private:
  void run();
  [[nodiscard]] Result follow(Job& job);
  struct Observed {
    std::size_t all = 0, own = 0;  ///< Gaussians
  };
  [[nodiscard]] std::optional<Observed> observe(const Job& job);

  stream::StreamModel& model_;
  Device device_;
  std::optional<PublishedModel> published_;  // the thread's own
  std::uint64_t copied_before_ = 0;          // too: bytes of models that were open before
  std::size_t observed_ = 0;                 // too: Gaussians of the newest, other replicas' included
  bus::FileDescriptor done_event_;
  bool busy_ = false;  // the owner's

  std::mutex mutex_;  // of all below
  std::condition_variable changed_;
  bool stop_ = false;
  std::optional<Job> job_;
  std::optional<Result> result_;
  std::exception_ptr failure_;

  std::thread thread_;  // last: it uses all of it
};

}  // namespace splatbus::streamer
