#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "gaussians/layout.h"
#include "gaussians/light.h"

namespace splatbus {

/// Gaussians in somebody else's memory (slab, vector, device): non-owning, cheap to copy. Pointers may be null where a
/// use does not need them; PLY and raster headers say which they read.
struct GaussiansView {
  ParameterLayout layout;
  std::size_t count = 0;
  std::size_t stride = 0;                    ///< columns of every plane, at least count
  const float* parameters = nullptr;         ///< [layout.channels()][stride]
  const float* normal = nullptr;             ///< [3][stride], unit, object's frame (Transfer)
  const float* surface_point = nullptr;      ///< [3][stride], where the sample was, object's frame
  const float* visibility = nullptr;         ///< [stride], sun visibility in [0, 1] (Transfer)
  const std::uint32_t* object_id = nullptr;  ///< [stride]; null: all static
  const std::uint32_t* flags = nullptr;      ///< [stride]; null: all active
  const std::uint64_t* gaussian_id = nullptr;
  const std::uint64_t* cell = nullptr;

  [[nodiscard]] const float* plane(int channel) const {
    return parameters + static_cast<std::size_t>(channel) * stride;
  }
};

/// Gaussians in host memory of our own.
class GaussiansBuffer {
 public:
  explicit GaussiansBuffer(ParameterLayout layout = {}, std::size_t count = 0);
  void resize(std::size_t count);  ///< keeps values; new ones are zero
  [[nodiscard]] GaussiansView view() const;
  [[nodiscard]] std::size_t count() const { return count_; }
  [[nodiscard]] const ParameterLayout& layout() const { return layout_; }
  [[nodiscard]] std::size_t stride() const { return stride_; }
  /// Deep copy of any view (null planes become zeros; surface_point defaults to the mean).
  static GaussiansBuffer copy_of(const GaussiansView& view);

  std::vector<float> parameters, normal, surface_point, visibility;
  std::vector<std::uint32_t> object_id, flags;
  std::vector<std::uint64_t> gaussian_id, cell;

 private:
  ParameterLayout layout_;
  std::size_t count_ = 0, stride_ = 0;
};

/// Writes the binary PLY layout of 3DGS (x y z nx ny nz f_dc f_rest opacity scale rot), world frame: object transforms
/// applied. Transfer models are baked under `scene.light` to SH degree 0, display space. Gaussians that are not
/// finite are left out. Throws std::runtime_error naming the path.
void write_ply(const std::string& path, const GaussiansView& gaussians, const SceneState& scene);

/// Reads any property order; properties that it does not know are skipped. Layout: Radiance, the degree that the f_rest
/// count gives. Throws std::runtime_error that names the file, the line or byte, and what was wrong; bounds every size.
[[nodiscard]] GaussiansBuffer read_ply(const std::string& path);

}  // namespace splatbus
