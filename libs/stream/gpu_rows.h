#pragma once

#include <array>
#include <cstdint>
#include <tuple>
#include <unordered_map>
#include <vector>

#include "stream/gpu_record.h"
#include "stream/replica.h"

namespace splatbus::stream {

/// What of the rows that a replica shows is out of date in a GPU's memory. Rows are the replica's: a Gaussian keeps its
/// row as long as its page's lanes stay. A row is written when its Gaussian changes, and a colour when the light on it
/// does: nothing else is. One thread, the replica's.
class GpuRows final : public ShownObserver {
 public:
  /// world_from_object, row-major [3][4].
  using Transform = std::array<float, 12>;

  /// Observes the replica, which outlives this.
  explicit GpuRows(Replica& replica) : replica_(replica) { replica.observe_with(*this); }
  GpuRows(const GpuRows&) = delete;
  GpuRows& operator=(const GpuRows&) = delete;

  /// As an origin: in no row.
  static constexpr std::uint32_t kNoRow = 0xFFFFFFFFU;
  /// What has become of rows since they were last taken, for who lets Gaussians fade that arrive or leave. Those that
  /// have moved, and the rows that they have left, are taken together, be they more than asked for.
  struct Turnover {
    std::vector<std::uint32_t> origins;  ///< in which row what is in each now was then, kNoRow where it was in none
    std::vector<std::uint8_t> left;      ///< whether what was in it then is in no row now
  };

  void on_reset(const ReplicatedState& shown) override;
  void on_change(const ReplicatedState& shown, const Change& change) override;

  /// Up to `most` rows that have changed since they were taken, ascending from where the last call ended, and what is
  /// in them now: a row that is free has no opacity. What is there already is overwritten.
  /// `harmonics`: harmonic_words() of each; for who draws them.
  void take_records(std::size_t most, std::vector<std::uint32_t>& rows, std::vector<GpuRecord>& records,
                    std::vector<std::uint32_t>* harmonics = nullptr, Turnover* turnover = nullptr);
  /// The same of rows in which nothing but the colour has changed. With harmonics there are none: they go with records.
  void take_colors(std::size_t most, std::vector<std::uint32_t>& rows, std::vector<std::uint32_t>& colors);
  /// As if nothing had been taken: the GPU's memory was lost.
  void forget_taken();

  /// Rows that were ever used.
  [[nodiscard]] std::size_t capacity() const { return stale_.size(); }
  [[nodiscard]] std::size_t unsent() const { return unsent_; }  ///< rows that wait for take_records()

  /// Of the objects, by the index that records have: 0 is the world. All zero for what is hidden, and the far field's
  /// is that of an eye in the origin: it moves with it.
  [[nodiscard]] const std::vector<Transform>& transforms();
  /// Their ids.
  [[nodiscard]] std::vector<std::uint32_t> object_ids() const {
    std::vector<std::uint32_t> ids;
    for (const Object& object : objects_) ids.push_back(object.id);
    return ids;
  }
  /// The same under another scene of the objects.
  [[nodiscard]] std::vector<Transform> transforms_in(const SceneState& scene) const;
  /// Index of the camera of the engine's player (kPlayerId), whose transform is world_from_camera. 0: the
  /// scene has none. To be read after transforms().
  [[nodiscard]] std::uint32_t player() const { return player_; }
  /// Index of the far field, 0 while nothing was seen of it.
  [[nodiscard]] std::uint32_t far_field() const { return far_field_; }

 private:
  struct Object {
    std::uint32_t id = 0;
    Light light;  ///< in the object's frame, when colours were last made
  };
  class Shader;
  enum Stale : std::uint8_t { kNothing = 0, kColor = 1, kRecord = 2, kTaking = 3 };

  /// kHidden when there is no room for another.
  [[nodiscard]] std::uint32_t index_of(std::uint32_t object_id);
  void forget_objects();
  /// Where Gaussians have been, before anything else of the change.
  void follow_moves(const std::vector<Change::Move>& moves);
  [[nodiscard]] bool has_moved(std::uint32_t row) const {
    return stale_[row] == kRecord && is_shown(row) && origin_[row] != row && origin_[row] != kNoRow;
  }
  /// [capacity()] Whether another row has the Gaussian that was in a row when it was last taken; empty: of none.
  [[nodiscard]] std::vector<bool> moved_away() const;
  void take_turnover(const std::vector<std::uint32_t>& rows, const std::vector<bool>& moved, Turnover& out);
  void mark(std::uint32_t row, Stale what);
  void mark_all(const std::vector<std::uint32_t>& rows, Stale what);
  /// How many rows of a block are Gaussians.
  void show(std::uint32_t block, std::uint32_t count);
  [[nodiscard]] bool is_shown(std::uint32_t row) const { return row % kBlockRows < shown_[row / kBlockRows]; }
  /// Objects' transforms and lights of the replica's scene; marks rows on which another light falls.
  void follow_scene();
  void find_player();
  /// Adds rows in that state, from the cursor on.
  void find_rows(std::size_t most, Stale wanted, std::size_t& cursor, std::vector<std::uint32_t>& rows) const;

  Replica& replica_;
  std::vector<std::uint32_t> shown_;  ///< rows of each block
  std::vector<std::uint8_t> stale_;   ///< [capacity()]
  /// [capacity()] The row that had its Gaussian when that row was last taken.
  std::vector<std::uint32_t> origin_;
  bool any_moved_ = false;  ///< of what has not been taken
  std::size_t unsent_ = 0, recolored_ = 0;
  std::size_t record_cursor_ = 0, color_cursor_ = 0;
  bool objects_are_new_ = true, objects_are_full_ = false;
  std::tuple<std::uint64_t, std::uint64_t, std::uint64_t> scene_key_;  ///< epoch, version, frame

  std::vector<Object> objects_{Object{}};
  std::vector<Transform> transforms_;
  std::unordered_map<std::uint32_t, std::uint32_t> index_of_object_{{0, 0}};
  std::uint32_t far_field_ = 0, player_ = 0;
};

}  // namespace splatbus::stream
