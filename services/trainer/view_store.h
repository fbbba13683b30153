#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <vector>

#include "trainer/kept_views.h"
#include "trainer/training_view.h"

namespace splatbus::trainer {

/// The newest view of each camera that can be trained on: one whose scene version has its visibility, of all its
/// lights. A newer one waits beside it for its own. Bounded in number and bytes: the camera that was updated longest
/// ago makes room. What is kept of earlier places has limits of its own. Thread-safe.
class ViewStore {
 public:
  static constexpr std::size_t kMaxViews = 1024;
  static constexpr std::size_t kMaxBytes = std::size_t{4} << 30;

  explicit ViewStore(std::size_t max_views = kMaxViews, std::size_t max_bytes = kMaxBytes);

  /// It replaces the camera's view when its version is paired, else whichever waited for that before.
  void put(TrainingViewPtr view);
  /// The scene versions whose visibility is there, ascending; nullopt, as in the beginning: no view needs any. A view
  /// whose version is not among them waits for it, where no newer one does already.
  void set_paired(std::optional<std::vector<PairedVersion>> versions);
  /// Scene versions of all views, those that wait too, ascending.
  [[nodiscard]] std::vector<std::uint64_t> versions() const;
  /// Views that were replaced before they were paired.
  [[nodiscard]] std::uint64_t unpaired() const;
  void retire(const ViewKey& key);
  /// Whether what reference cameras saw of where they stood before is kept; not at first.
  void set_keeps(bool keeps);

  /// A few of what is kept about that view's place, those that were asked for longest ago.
  [[nodiscard]] std::vector<TrainingViewPtr> kept_about(const TrainingView& view);
  /// Of kept views, which are not true any more.
  void drop_kept(std::span<const std::uint32_t> numbers);

  /// To train on; null when there is none.
  [[nodiscard]] TrainingViewPtr find(const ViewKey& key) const;
  /// Of cameras, whether they have a view to train on or wait for it.
  [[nodiscard]] std::vector<ViewKey> keys(CameraRole role) const;
  /// Of what is kept of the surroundings of where reference cameras stand now.
  [[nodiscard]] std::vector<ViewKey> kept_keys() const;
  [[nodiscard]] bool any_to_train(CameraRole role) const;
  [[nodiscard]] std::size_t count(CameraRole role) const;
  [[nodiscard]] std::size_t kept() const;
  [[nodiscard]] std::size_t bytes() const;
  [[nodiscard]] std::size_t max_bytes() const { return max_bytes_; }
  /// Grows whenever a camera comes or goes.
  [[nodiscard]] std::uint64_t cameras_version() const;

 private:
  struct Entry {
    TrainingViewPtr view, waiting;  ///< one of them may be null
    bool waits_again = false;       ///< the one that waits could be trained on before
    std::uint64_t updated = 0;
  };
  [[nodiscard]] bool is_paired(const TrainingView& view) const;
  void replace(TrainingViewPtr& old, TrainingViewPtr view);
  using Views = std::vector<TrainingViewPtr>;
  /// Gives the camera its next view, and keeps what it had. Returns what has gone for that.
  [[nodiscard]] Views succeed(Entry& entry, TrainingViewPtr view);
  [[nodiscard]] std::vector<Camera> reference_cameras() const;
  void evict(const ViewKey& newest);
  void drop(Entry& entry);  ///< one that waits never trained for want of its visibility

  const std::size_t max_views_, max_bytes_;
  mutable std::mutex mutex_;
  std::map<ViewKey, Entry> views_;
  std::optional<std::vector<PairedVersion>> paired_;
  bool keeps_ = false;
  KeptViews kept_;
  std::size_t bytes_ = 0;  // without kept_
  std::uint64_t updates_ = 0, cameras_version_ = 0, unpaired_ = 0;
};

}  // namespace splatbus::trainer
