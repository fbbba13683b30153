#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <utility>
#include <vector>

#include "bus/slab.h"
#include "gaussians/light.h"

namespace splatbus::trainer {

/// An array that never changes and that several own, in either kind of memory; whoever holds it knows which.
template <class T>
class Pixels {
 public:
  Pixels() = default;
  Pixels(std::shared_ptr<const T> data, std::size_t size) : data_(std::move(data)), size_(size) {}
  /// In host memory.
  explicit Pixels(std::vector<T> values) : size_(values.size()) {
    auto owner = std::make_shared<const std::vector<T>>(std::move(values));
    data_ = {owner, owner->data()};
  }

  [[nodiscard]] const T* data() const { return data_.get(); }
  [[nodiscard]] std::size_t size() const { return size_; }
  [[nodiscard]] bool empty() const { return size_ == 0; }
  [[nodiscard]] std::size_t bytes() const { return size_ * sizeof(T); }
  /// Host memory only.
  const T& operator[](std::size_t i) const { return data_.get()[i]; }

 private:
  std::shared_ptr<const T> data_;
  std::size_t size_ = 0;
};

/// An engine render to train on, in memory of our own. Immutable once it is in the store.
struct TrainingView {
  Camera camera;
  SceneState scene;  ///< light and object transforms of that very frame
  std::uint64_t frame = 0;
  Device memory = Device::Cpu;  ///< where the pictures lie
  Pixels<std::uint8_t> color;   ///< [h][w][4], display space
  Pixels<std::uint8_t> albedo;  ///< the same, or empty
  Pixels<float> depth;          ///< [h][w] metres along z, 0 where there is no surface; or empty
  Pixels<std::uint8_t> mask;    ///< [h][w] not 0 where nothing is to be learned; or empty

  [[nodiscard]] std::size_t bytes() const { return color.bytes() + albedo.bytes() + depth.bytes() + mask.bytes(); }
};

using TrainingViewPtr = std::shared_ptr<const TrainingView>;

/// Identity of a view: its camera.
struct ViewKey {
  CameraRole role = CameraRole::Reference;
  std::uint32_t id = 0;
  // NOLINTNEXTLINE(modernize-use-nullptr): clang-tidy 14 takes the comparison with 0 that is generated for a pointer's.
  auto operator<=>(const ViewKey&) const = default;
};

[[nodiscard]] inline ViewKey key_of(const TrainingView& view) {
  return {.role = view.camera.role, .id = view.camera.id};
}

/// A scene version whose visibility is there, and of which lights.
struct PairedVersion {
  std::uint64_t version = 0;
  std::vector<std::uint32_t> light_ids{0};
};

/// The newest view of each camera that can be trained on: one whose scene version has its visibility, of all its
/// lights. A newer one waits beside it for its own. Bounded in number and bytes: the camera that was updated longest
/// ago makes room. Thread-safe.
class ViewStore {
 public:
  static constexpr std::size_t kMaxViews = 1024;
  static constexpr std::size_t kMaxBytes = std::size_t{2} << 30;

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

  /// To train on; null when there is none.
  [[nodiscard]] TrainingViewPtr find(const ViewKey& key) const;
  /// Of cameras, whether they have a view to train on or wait for it.
  [[nodiscard]] std::vector<ViewKey> keys(CameraRole role) const;
  [[nodiscard]] bool any_to_train(CameraRole role) const;
  [[nodiscard]] std::size_t count(CameraRole role) const;
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
  void evict(const ViewKey& newest);

  const std::size_t max_views_, max_bytes_;
  mutable std::mutex mutex_;
  std::map<ViewKey, Entry> views_;
  std::optional<std::vector<PairedVersion>> paired_;
  std::size_t bytes_ = 0;
  std::uint64_t updates_ = 0, cameras_version_ = 0, unpaired_ = 0;
};

}  // namespace splatbus::trainer
