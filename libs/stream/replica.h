#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>

#include "stream/display_changes.h"
#include "stream/replicated_state.h"

namespace splatbus::stream {

/// Broadcast packets that did not arrive, both ends included.
struct MissingPackets {
  std::uint64_t first = 0, last = 0;
  bool operator==(const MissingPackets&) const = default;
};

/// Is told of what changes in what a replica shows, by the column, when it has changed: for who reads the state in
/// place, where DisplayChanges bring copies.
class ShownObserver {
 public:
  virtual ~ShownObserver() = default;
  /// Another state is shown: nothing of it is known.
  virtual void on_reset(const ReplicatedState& shown) = 0;
  /// Not of Kind::Nothing.
  virtual void on_change(const ReplicatedState& shown, const Change& change) = 0;
  /// Column i was column order[i]: a permutation of all columns.
  virtual void on_order(std::span<const std::uint32_t> order) = 0;
};

/// What a viewer holds. Packets go in; scene, and what changes of the Gaussians, come out. Not thread-safe.
///
/// A snapshot is gathered beside what is shown: its chunks are shown as they arrive where nothing was shown before,
/// else the old picture stays until the new one is whole. Broadcast packets that arrive early wait (up to a bound) for
/// those missing before them, and for the end of a snapshot: the ids that close it are those of its slots.
class Replica {
 public:
  explicit Replica(std::size_t max_gaussians = kMaxGaussians) : max_gaussians_(max_gaussians) {}

  /// From now on `observer`, which outlives this, is told, and take_changes() gives nothing.
  void observe_with(ShownObserver& observer);

  /// Takes any packet of the stream; those that are not about the model (Welcome, ProbePicture, ...) change nothing.
  /// True when the picture may have changed. Throws StreamError when the packet is wrong: what is held stays as it was,
  /// and needs_snapshot() says whether the stream can be followed any further.
  bool receive(const ParsedPacket& packet);

  /// What a DisplayGaussians does, after all that was taken before, to show what is shown now. Few bytes more than
  /// twice those of whole(), however long nobody takes them.
  [[nodiscard]] DisplayChanges take_changes();
  /// What a DisplayGaussians does to show it, whatever it has shown before.
  [[nodiscard]] DisplayChanges whole() const;
  /// Whether it is better to take whole() than changes of that size.
  [[nodiscard]] bool exceeds_whole(const DisplayChanges& changes) const;

  /// Gaussians that are shown.
  [[nodiscard]] std::size_t count() const { return shown_state().gaussians.count(); }
  [[nodiscard]] const ParameterLayout& layout() const { return shown_state().layout.parameters(); }
  /// What they are lit by and where their objects are.
  [[nodiscard]] const SceneState& scene() const { return shown_state().scene; }
  [[nodiscard]] std::uint64_t scene_version() const { return scene().version; }
  /// Scene version that the Gaussians' visibility is of; 0 where it is the model's own.
  [[nodiscard]] std::uint64_t visibility_version() const { return shown_state().visibility_version; }
  [[nodiscard]] const SceneInstant& scene_instant() const { return shown_state().instant; }

  /// Epoch that is followed, 0 before the first SnapshotBegin.
  [[nodiscard]] std::uint64_t epoch() const;
  /// Until all of a snapshot has come, the ids included.
  [[nodiscard]] bool loading() const { return loading_.has_value() || missing_ids_ > 0 || missing_rows_ > 0; }
  [[nodiscard]] std::uint32_t missing_chunks() const;

  /// What to ask a Resend for; nullopt while nothing is known to be missing.
  [[nodiscard]] std::optional<MissingPackets> missing() const;
  /// A broadcast packet did not apply, or a snapshot was refused: only another snapshot helps.
  [[nodiscard]] bool needs_snapshot() const { return !refusal_.empty(); }
  /// Why; empty while nothing is wrong.
  [[nodiscard]] const std::string& refusal() const { return refusal_; }

  /// Exactly what is held, null before the first whole snapshot. For tests and statistics.
  [[nodiscard]] const ReplicatedState* held() const { return held_.get(); }
  /// What is shown, an empty state before there is any. Valid until the next packet.
  [[nodiscard]] const ReplicatedState& shown_state() const;

 private:
  struct Chunk {
    std::size_t column = 0, count = 0;  ///< where it lies in `Loading::state`
  };
  struct Loading {
    std::uint64_t snapshot = 0;
    std::size_t total = 0, chunk_count = 0, light_rows = 0;
    std::map<std::size_t, Chunk> chunks;  ///< by first slot
    ReplicatedState state;                ///< chunks in the order of their arrival
  };

  void begin(const wire::SnapshotBegin& body, std::uint64_t epoch);
  [[nodiscard]] StreamLayout layout_of(const wire::SnapshotBegin& body);
  bool load(const ParsedPacket& packet);
  bool load_chunk(const ParsedPacket& packet);
  bool load_ids(const ParsedPacket& packet);
  bool load_light_row(const ParsedPacket& packet);
  void finish_loading();
  [[noreturn]] void refuse_snapshot(const std::string& why);
  bool apply_in_order(const ParsedPacket& packet);
  bool apply_to(ReplicatedState& state, const ParsedPacket& packet);
  void note(const ReplicatedState& state, const Change& change);
  void note(DisplayChange change);
  /// After another state is shown, or what is shown has become another.
  void show_whole();
  bool drain();
  void keep(const ParsedPacket& packet);
  [[nodiscard]] const ReplicatedState* shown() const;
  [[nodiscard]] std::uint64_t base() const;

  std::size_t max_gaussians_;
  std::unique_ptr<ReplicatedState> held_;
  std::optional<Loading> loading_;
  std::size_t missing_ids_ = 0, missing_rows_ = 0;  ///< of the snapshot whose chunks are all held
  std::map<std::uint64_t, ParsedPacket> early_;
  std::size_t early_bytes_ = 0;
  std::uint64_t last_known_ = 0;
  ShownObserver* observer_ = nullptr;
  DisplayChanges changes_;  ///< that nobody has taken yet; none where somebody observes
  std::string refusal_;
};

}  // namespace splatbus::stream
