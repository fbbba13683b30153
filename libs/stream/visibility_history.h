#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <vector>

#include "stream/display_changes.h"

namespace splatbus::stream {

/// What the Gaussians of a display saw of the lights when the scene was of an earlier version, so that a picture of
/// that version can be drawn with its own shadows: visibility arrives all the time, and the engine's picture of an
/// instant later than what belongs to it. One thread.
class VisibilityHistory {
 public:
  static constexpr std::size_t kMaxEntries = 64;
  static constexpr std::size_t kMaxValues = std::size_t{1} << 20;  ///< of all lights, five bytes each

  /// What a DisplayGaussians is given, in the same order.
  void add(const DisplayChanges& changes);

  /// The version nearest to `scene_version`, of those that are kept; where that is 0, not known, the newest.
  [[nodiscard]] std::uint64_t nearest(std::uint64_t scene_version) const { return version_of(find(scene_version)); }

  /// What a display that has had all of it does to show the visibility of nearest(), and what it does afterwards to
  /// show the newest again. A Gaussian that came since is as it came, with the first that was said of what it sees.
  /// Both are empty where the newest is the nearest.
  struct Turn {
    std::uint64_t version = 0;  ///< of what is shown then
    DisplayChanges there, back;
  };
  [[nodiscard]] Turn turn_to(std::uint64_t scene_version);

 private:
  /// Values as they were before they changed, in the order in which they did.
  struct Before {
    std::vector<std::uint32_t> rows;
    Bytes values;
  };
  /// What changed while the newest visibility was of one version.
  struct Entry {
    std::uint32_t number = 1;
    std::uint64_t version = 0;
    std::map<std::uint32_t, Before> lights;  ///< by id, 0 the sun
  };

  void add(const DisplayReset& change);
  void add(const DisplayRows& change);
  void add(const DisplayValues& change);
  void add(const DisplayObjects&) {}
  void add(const DisplayBlocks&) {}
  void add(const DisplayLights& change);
  void add(const DisplaySeen& change);
  void add(const DisplayVisibility& change);
  template <class Value>
  void see(std::uint32_t light_id, const std::vector<std::uint32_t>& rows, const std::vector<Value>& values);
  void drop_oldest();
  void forget();
  [[nodiscard]] static std::size_t values_of(const Entry& entry);
  /// Of entries_, whose end() stands for open_.
  [[nodiscard]] std::size_t find(std::uint64_t scene_version) const;
  [[nodiscard]] std::uint64_t version_of(std::size_t entry) const {
    return entry < entries_.size() ? entries_[entry].version : open_.version;
  }
  /// Adds to `then` what was seen of the light before the entry, in place of what it has of the same row.
  void undo(const Entry& entry, std::uint32_t light_id, Before& then);
  void emit(std::uint32_t light_id, std::vector<std::uint32_t> rows, const Bytes& values, DisplayChanges& out) const;

  int visibility_channel_ = -1;          ///< of the layout; none: there is nothing to keep
  std::map<std::uint32_t, Bytes> seen_;  ///< [rows] now, by light; a row beyond the end sees all
  std::vector<std::uint32_t> came_in_;   ///< [rows] number of the entry in which its Gaussian came; 0: before all
  std::vector<std::uint32_t> awaits_;    ///< [rows] lights, in a bit each, of which nothing was said since it came
  std::deque<Entry> entries_;            ///< what the first has is never undone, and is not kept
  Entry open_;                           ///< the newest version's
  std::size_t values_ = 0;               ///< of all entries
  static constexpr std::uint32_t kNone = ~std::uint32_t{0};
  std::vector<std::uint32_t> place_;  ///< [rows] in what undo() adds to; kNone between calls of turn_to()
};

}  // namespace splatbus::stream
