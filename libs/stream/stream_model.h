#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <span>
#include <unordered_map>
#include <vector>

#include "gaussians/camera.h"
#include "stream/delta_selection.h"
#include "stream/model_quantizer.h"
#include "stream/replicated_state.h"

namespace splatbus::stream {

struct StreamOptions {
  std::size_t chunk_gaussians = 4096;         ///< a Snapshot packet at most
  std::size_t max_gaussians = kMaxGaussians;  ///< that viewers hold; of a larger model a part is served
  Schedules schedules = default_schedules();
  std::uint32_t calm_ticks = 8;
};

/// As relight says it.
struct LightsVisibility {
  std::span<const std::uint32_t>
      light_ids;                           ///< ascending, 0 is the sun; those that the scene does not have are left out
  std::span<const std::uint8_t> of_index;  ///< [light_ids][indices of the model], 255 sees all of the light
  std::uint64_t scene_version = 0;
};

/// A snapshot of the held state, encoded once for however many viewers join.
struct EncodedSnapshot {
  std::uint64_t as_of = 0;
  std::vector<EncodedPacket> head;    ///< SnapshotBegin, Scene
  std::vector<EncodedPacket> chunks;  ///< by slot
  std::vector<EncodedPacket> tail;    ///< LightVisibility, GaussianOrder
};

/// The streamer's side: a mirror of what every viewer holds, and the packets that bring it nearer to the published
/// model. The mirror changes only by the very bytes that are sent, and packets are numbered as they are made.
///
/// One thread, or two: while one of them observes, ticks or resets, the other may call take_scene(), take_packets() and
/// status(), which wait for one packet at most (a reset for longer), and nothing else.
class StreamModel {
 public:
  /// `device`: in whose memory the views lie that observe() is given.
  StreamModel(PacketWriter writer, std::uint64_t stream_epoch, const StreamOptions& options = {},
              Device device = Device::Cpu);

  /// Quantizes what is published now into memory of its own; `still_valid` says afterwards whether what was read was
  /// whole. False when it was not: everything is as before. After a view of another layout (appearance, degree) ready()
  /// is false.
  bool observe(const GaussiansView& gaussians, const std::function<bool()>& still_valid = {});
  /// The broadcast packet that brings a newer scene to viewers: none where its version is the one that is held, or
  /// while nobody holds anything. It is the last of take_packets(), which are returned. Throws StreamError, naming what
  /// is wrong, when its version is 0 or runs backwards, or the scene is none that travels (quantize_scene); all is then
  /// as before.
  [[nodiscard]] std::vector<EncodedPacket> take_scene(const SceneState& scene, const SceneInstant& instant);
  void set_schedules(const Schedules& schedules);

  /// What was observed becomes what is held, without packets: for when nobody holds anything, or everybody gets a
  /// snapshot. Takes one sequence number, so that whoever held something before notices.
  void reset_to_target();
  /// Nobody holds anything any more: the next reset_to_target() may choose other quantizers.
  void release() { set_ready(false); }
  /// False before the first reset_to_target(), after release(), and when the observed layout is another one: only
  /// reset_to_target() helps.
  [[nodiscard]] bool ready() const { return ready_; }
  [[nodiscard]] bool observed() const { return target_layout_.has_value(); }

  struct Status {
    bool ready = false;
    std::uint64_t epoch = 0, sequence = 0, visibility_version = 0;
    std::size_t gaussians = 0;
    ParameterLayout layout;
  };
  /// Of what is held.
  [[nodiscard]] Status status() const;
  /// Broadcast packets, by sequence, that were not taken yet.
  [[nodiscard]] std::vector<EncodedPacket> take_packets();

  /// Broadcast packets with what has changed of the lights' visibility, one a light: none when it is older than what is
  /// held, or nobody holds anything. Light by light, what changes the pictures most first, until their bytes exceed
  /// `budget_bytes`; visibility_rests() says whether that was all, and a light that has waited comes sooner. Of a light
  /// that was sent what is held is within kMaxVisibilityError, and exact where it is 0 or 255. Throws StreamError when
  /// `visibility` is too short for the model that was observed last.
  [[nodiscard]] std::vector<EncodedPacket> take_visibility(const LightsVisibility& visibility,
                                                           double budget_bytes = kNoBudget);
  [[nodiscard]] bool visibility_rests() const { return visibility_waits_.empty(); }
  static constexpr double kNoBudget = 1e300;
  static constexpr int kMaxVisibilityError = 6;

  /// Broadcast packets of one tick: removals, object ids, new Gaussians, deltas. What viewers see
  /// most comes first, and appended Gaussians and deltas stay near `budget_bytes`. Asserts ready(). When it throws,
  /// ready() is then false.
  [[nodiscard]] std::vector<EncodedPacket> tick(double budget_bytes, std::span<const Camera> viewers);
  /// The same, for take_packets(). Returns the packets' bytes.
  double make_tick(double budget_bytes, std::span<const Camera> viewers);

  [[nodiscard]] EncodedSnapshot snapshot();
  /// Chunks of a snapshot of what is held now, most visible from `camera` first. Without a camera: as they come.
  [[nodiscard]] std::vector<std::size_t> chunk_order(const std::optional<Camera>& camera) const;

  [[nodiscard]] const ReplicatedState& held() const { return held_; }
  [[nodiscard]] std::size_t observed_count() const { return target_.count(); }
  [[nodiscard]] const QuantizedGaussians& observed_gaussians() const { return target_; }
  [[nodiscard]] const ModelQuantizer& quantizer() const { return quantizer_; }
  [[nodiscard]] std::size_t unsent() const { return fresh_.size(); }  ///< observed, not held, after the last tick
  /// Viewers hold as many Gaussians as they take, and the model has more.
  [[nodiscard]] bool full() const { return room() == 0 && !fresh_.empty(); }
  [[nodiscard]] std::size_t pending_deltas() const { return selection_.pending(); }

 private:
  template <class Build>
  void emit(wire::Body body, Build&& build, Payload payload = {});
  /// Into the mirror and, if that takes it, to those that wait to be sent. Under mutex_.
  void take_packet(EncodedPacket packet);
  [[nodiscard]] EncodedPacket scene_packet(std::uint64_t sequence, const QuantizedScene* base) const;
  void hold_scene();
  void set_ready(bool ready) {
    const std::scoped_lock lock(mutex_);
    ready_ = ready;
  }
  struct LightChange {
    std::uint32_t light_id = 0;
    SlotValues change;
    double weight = 0;  ///< in the pictures
  };
  [[nodiscard]] LightChange change_of(std::uint32_t light_id, std::span<const std::uint8_t> of_index) const;
  [[nodiscard]] EncodedPacket light_packet(std::uint64_t sequence, const LightChange& light) const;
  [[nodiscard]] std::vector<EncodedPacket> light_rows() const;
  [[nodiscard]] std::vector<std::uint32_t> slots_of(std::span<const std::uint64_t> ids) const;
  void map_columns();
  void index_ids();
  [[nodiscard]] std::size_t room() const;
  void tick_removals();
  void tick_objects();
  void tick_appends(double budget_bytes, std::span<const Camera> viewers, const ObjectTransforms& objects);
  void append_chunk(std::span<const std::uint32_t> columns);
  void tick_deltas(double budget_bytes, std::span<const Camera> viewers, const ObjectTransforms& objects);

  PacketWriter writer_, brief_writer_ = PacketWriter::brief();
  StreamOptions options_;
  ModelQuantizer quantizer_;
  DeltaSelection selection_;
  double tick_bytes_ = 0;  ///< of this tick's packets

  // What two threads touch. Who observes and ticks reads the Gaussians, their layout and ready_ without it: nobody else
  // writes them.
  mutable std::mutex mutex_;
  ReplicatedState held_;
  bool ready_ = false;
  QuantizedScene scene_;  ///< newest; held, where anything is
  SceneInstant instant_;
  std::vector<EncodedPacket> made_;  ///< that nobody has taken

  std::optional<StreamLayout> target_layout_;
  QuantizedGaussians target_;
  std::vector<IndexRange> target_ranges_;  ///< indices of its columns
  std::vector<std::uint8_t> usable_;
  std::vector<std::uint32_t> slot_of_column_;  ///< kNotHeld: not held
  std::vector<std::uint32_t> column_of_slot_;  ///< kNotHeld: not in the target, or not usable
  std::vector<std::uint32_t> gone_;            ///< slots that the target has no more, ascending
  std::vector<std::uint32_t> fresh_;           ///< columns that are usable and not held
  std::unordered_map<std::uint64_t, std::uint32_t> slot_of_id_;
  std::map<std::uint32_t, std::uint32_t> visibility_waits_;  ///< times that a light was left for later
  double chunk_bytes_per_gaussian_ = 24;
  std::uint64_t snapshots_ = 0;
};

}  // namespace splatbus::stream
