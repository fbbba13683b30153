#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "stream/display_gaussians.h"
#include "stream/replicated_state.h"

namespace splatbus::stream {

/// Broadcast packets that did not arrive, both ends included.
struct MissingPackets {
  std::uint64_t first = 0, last = 0;
  bool operator==(const MissingPackets&) const = default;
};

/// What a viewer holds. Packets go in, Gaussians and scene come out. Not thread-safe. All of it throws
/// std::runtime_error when the device fails.
///
/// A snapshot is gathered beside what is shown: its chunks are shown as they arrive where nothing was shown before,
/// else the old picture stays until the new one is whole. Broadcast packets that arrive early wait (up to a bound) for
/// those missing before them, and for the end of a snapshot: the ids that close it are those of its slots.
class Replica {
 public:
  /// `device`: where view() lies.
  explicit Replica(std::size_t max_gaussians = kMaxGaussians, Device device = Device::Cpu)
      : max_gaussians_(max_gaussians), stream_(device) {}

  /// Takes any packet of the stream; those that are not about the model (Welcome, ProbePicture, ...) change nothing.
  /// True when the picture may have changed. Throws StreamError when the packet is wrong: what is held stays as it was,
  /// and needs_snapshot() says whether the stream can be followed any further.
  bool receive(const ParsedPacket& packet);

  [[nodiscard]] GaussiansView view() const;
  /// Another number whenever view() is another, or its planes hold other values.
  [[nodiscard]] std::uint64_t version() const { return version_; }
  /// What view() is lit by and where its objects are.
  [[nodiscard]] const SceneState& scene() const { return shown_state().scene; }
  [[nodiscard]] std::uint64_t scene_version() const { return scene().version; }
  /// Scene version that view()'s visibility is of; 0 where it is the model's own.
  [[nodiscard]] std::uint64_t visibility_version() const { return shown_state().visibility_version; }
  [[nodiscard]] const SceneInstant& scene_instant() const { return shown_state().instant; }

  /// Epoch that is followed, 0 before the first SnapshotBegin.
  [[nodiscard]] std::uint64_t epoch() const;
  /// Until all of a snapshot has come, the ids included.
  [[nodiscard]] bool loading() const { return loading_.has_value() || missing_ids_ > 0; }
  [[nodiscard]] std::uint32_t missing_chunks() const;

  /// What to ask a Resend for; nullopt while nothing is known to be missing.
  [[nodiscard]] std::optional<MissingPackets> missing() const;
  /// A broadcast packet did not apply, or a snapshot was refused: only another snapshot helps.
  [[nodiscard]] bool needs_snapshot() const { return !refusal_.empty(); }
  /// Why; empty while nothing is wrong.
  [[nodiscard]] const std::string& refusal() const { return refusal_; }

  /// Exactly what is held, null before the first whole snapshot. For tests and statistics.
  [[nodiscard]] const ReplicatedState* held() const { return held_ ? &held_->state : nullptr; }

 private:
  struct Shown {
    Shown(const StreamLayout& layout, device::StreamView stream) : display(layout, stream) {}
    ReplicatedState state;
    DisplayGaussians display;
  };
  struct Chunk {
    std::size_t column = 0, count = 0;  ///< where it lies in `Loading::shown`
  };
  struct Loading {
    Loading(const StreamLayout& layout, device::StreamView stream) : shown(layout, stream) {}
    std::uint64_t snapshot = 0;
    std::size_t total = 0, chunk_count = 0;
    std::map<std::size_t, Chunk> chunks;  ///< by first slot
    Shown shown;                          ///< chunks in the order of their arrival
  };

  void begin(const wire::SnapshotBegin& body, std::uint64_t epoch);
  [[nodiscard]] StreamLayout layout_of(const wire::SnapshotBegin& body);
  bool load(const ParsedPacket& packet);
  bool load_chunk(const ParsedPacket& packet);
  bool load_ids(const ParsedPacket& packet);
  void finish_loading();
  [[noreturn]] void refuse_snapshot(const std::string& why);
  bool apply_in_order(const ParsedPacket& packet);
  bool apply_to(Shown& shown, const ParsedPacket& packet);
  bool drain();
  void keep(const ParsedPacket& packet);
  [[nodiscard]] const Shown* shown() const;
  [[nodiscard]] const ReplicatedState& shown_state() const;
  [[nodiscard]] std::uint64_t base() const;

  std::size_t max_gaussians_;
  device::Stream stream_;
  std::unique_ptr<Shown> held_;
  std::optional<Loading> loading_;
  std::size_t missing_ids_ = 0;  ///< of the snapshot whose chunks are all held
  std::map<std::uint64_t, ParsedPacket> early_;
  std::size_t early_bytes_ = 0;
  std::uint64_t last_known_ = 0, version_ = 0;
  std::string refusal_;
};

}  // namespace splatbus::stream
