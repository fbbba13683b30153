#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "bus/subscriber.h"

namespace splatbus::gateway {

/// A service of the pipeline, as the broker and its own heartbeats tell of it.
struct ServiceFigures {
  std::string source, kind, state, detail, backend;
  std::uint32_t pid = 0;
  bool alive = false;
  double age_s = 0;  ///< since its last heartbeat
  std::map<std::string, double> counters;
};

/// Of stream/stats, what only grows while a streamer runs.
struct StreamCounts {
  std::uint64_t total_bytes = 0, whole_pages = 0, lost_packets = 0, lost_viewers = 0;
  struct Type {
    std::uint64_t packets = 0, bytes = 0;
  };
  std::map<std::string, Type> by_type;
};

/// stream/stats.
struct StreamFigures : StreamCounts {
  std::uint64_t epoch = 0, version = 0, pages = 0, gaussians = 0, model_gaussians = 0;
  std::uint32_t viewers = 0;
  double wire_mbps = 0, wire_mbps_mean = 0, wire_mbps_peak = 0;
};

/// trainer/stats.
struct TrainerFigures {
  std::uint64_t step = 0, views = 0, gaussians = 0, active = 0, frozen = 0, spilled = 0, unpaired_views = 0;
  std::uint64_t device_bytes = 0, host_bytes = 0, disk_bytes = 0;
  std::uint32_t pages_active = 0, pages_frozen = 0, pages_spilled = 0, ready_references = 0, ready_inputs = 0;
  double steps_per_s = 0, views_per_s = 0, loss = 0, masked_share = 0;
  bool paused = false;
};

/// How a viewer's picture compares with the engine's, by viewer/quality.
struct QualityFigures {
  double ssim = 0, psnr_db = 0, flip = 0;
};

/// What the bus says of the pipeline. Bounded, whatever is published: the first 64 services, 32 packet types, 64
/// counters each. One thread.
class PipelineView {
 public:
  explicit PipelineView(std::shared_ptr<bus::Context> context);

  /// Takes what has come. Never waits.
  void poll(std::int64_t now_ns);

  [[nodiscard]] std::vector<ServiceFigures> services(std::int64_t now_ns) const;
  /// Of all streamers together: sums, and of the model what the one that started last says. What is counted never
  /// falls: it has what streamers counted that are gone, or began anew. Nullopt where nothing came for 10 s.
  [[nodiscard]] std::optional<StreamFigures> stream(std::int64_t now_ns) const;
  /// Null where nothing came for 10 s.
  [[nodiscard]] const TrainerFigures* trainer(std::int64_t now_ns) const { return fresh(trainer_, now_ns); }
  /// The newest. Null where nothing came for 10 s.
  [[nodiscard]] const QualityFigures* quality(std::int64_t now_ns) const { return fresh(quality_, now_ns); }

  /// Empty, or what keeps viewers from being served.
  [[nodiscard]] std::string ill_because(std::int64_t now_ns) const;

 private:
  template <class Figures>
  struct Heard {
    std::optional<Figures> figures;
    std::int64_t heard_ns = 0;
  };
  template <class Figures>
  [[nodiscard]] static const Figures* fresh(const Heard<Figures>& heard, std::int64_t now_ns) {
    return heard.figures && now_ns - heard.heard_ns < 10'000'000'000 ? &*heard.figures : nullptr;
  }
  struct Streamer {
    Heard<StreamFigures> heard;
    std::uint64_t start = 0;  ///< epoch of the process
  };
  void take_stream(const wire::StreamStats& stats, const bus::Message& message);
  /// Whether there is room for one more; makes it of the one that is silent the longest.
  bool make_room_for_streamer();
  void take_heartbeat(const wire::Heartbeat& heartbeat);
  void take_liveness(const wire::Liveness& liveness, const bus::Message& message);

  bus::Subscriber subscriber_;
  std::int64_t now_ns_ = 0;
  std::vector<ServiceFigures> nodes_;            ///< of the newest liveness
  std::int64_t liveness_ns_ = 0;                 ///< when it was heard; 0: only a held one, or none
  std::map<std::string, ServiceFigures> beats_;  ///< by source; what liveness does not say
  std::map<std::string, Streamer> streams_;      ///< by source; silent ones too: what they counted is in counted_
  StreamCounts counted_;                         ///< by all streamers there have been
  Heard<TrainerFigures> trainer_;
  Heard<QualityFigures> quality_;
};

}  // namespace splatbus::gateway
