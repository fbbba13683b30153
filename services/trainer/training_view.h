#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "device/device.h"
#include "gaussians/camera.h"
#include "gaussians/light.h"
#include "gaussians/occlusion.h"

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
  Device memory = Device::Cpu;    ///< where the pictures lie
  Pixels<std::uint8_t> color;     ///< [h][w][4], display space
  Pixels<std::uint8_t> albedo;    ///< the same, or empty
  Pixels<float> depth;            ///< [h][w] metres along z, 0 where there is no surface; or empty
  Pixels<std::uint8_t> mask;      ///< [h][w] not 0 where nothing is to be learned; or empty
  Pixels<float> farthest_m;       ///< FarthestSurfaces of the depth; or empty
  std::uint32_t kept_number = 0;  ///< among those of where cameras stood before; 0: the camera's own

  [[nodiscard]] FarthestSurfaces farthest_surfaces() const { return {farthest_m.data()}; }
  [[nodiscard]] std::size_t bytes() const {
    return color.bytes() + albedo.bytes() + depth.bytes() + mask.bytes() + farthest_m.bytes();
  }
};

using TrainingViewPtr = std::shared_ptr<const TrainingView>;

/// Identity of a view: its camera, or its number among those that are kept.
struct ViewKey {
  CameraRole role = CameraRole::Reference;
  std::uint32_t id = 0;
  std::uint32_t kept_number = 0;
  // NOLINTNEXTLINE(modernize-use-nullptr): clang-tidy 14 takes the comparison with 0 that is generated for a pointer's.
  auto operator<=>(const ViewKey&) const = default;
};

[[nodiscard]] inline ViewKey key_of(const TrainingView& view) {
  return {.role = view.camera.role, .id = view.camera.id, .kept_number = view.kept_number};
}

/// A scene version whose visibility is there, and of which lights.
struct PairedVersion {
  std::uint64_t version = 0;
  std::vector<std::uint32_t> light_ids{0};
};

}  // namespace splatbus::trainer
