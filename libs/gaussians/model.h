#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "gaussians/layout.h"
#include "gaussians/light.h"
#include "gaussians/occlusion.h"
#include "gaussians/pages.h"

namespace splatbus {

/// Gaussians in somebody else's memory (slab, vector, device): non-owning, cheap to copy. Pointers may be null where a
/// use does not need them; the headers of libs/splats and libs/raster say which they read.
///
/// Every channel of Gaussian i lies at offset(i) from where the channel begins, in one of two ways: channel by channel
/// for all Gaussians ([channels][stride], no pages), or page by page (gaussians/pages.h: [page][channels][kPageLanes],
/// page_stride apart), and then `ranges` says which indices are Gaussians.
struct GaussiansView {
  ParameterLayout layout;
  std::size_t count = 0;                ///< indices below it may be Gaussians
  std::size_t stride = 0;               ///< elements from one channel to the next
  std::uint32_t page_shift = kNoPages;  ///< index >> page_shift is the page
  std::size_t page_stride = 0;          ///< 4-byte words from one page to the next
  std::span<const IndexRange> ranges;   ///< which indices are Gaussians, ascending; with pages only
  std::span<const PageBounds> bounds;   ///< of each range; empty: unknown
  /// Of each range: another one whenever its page has other Gaussians, freezes or thaws; empty: unknown.
  std::span<const std::uint64_t> generations;
  const float* parameters = nullptr;     ///< [layout.channels()][stride]
  const float* normal = nullptr;         ///< [3][stride], unit, object's frame (Transfer)
  const float* surface_point = nullptr;  ///< [3][stride], where the sample was, object's frame
  const float* visibility = nullptr;     ///< [stride], sun visibility in [0, 1] (Transfer)
  /// [visibility_rows][visibility_stride], a row a light, by index, not at an offset: 255 sees all of the light. The
  /// sun's row, read instead of `visibility`, then those of Light::sources in their order; a source that has no row is
  /// not shadowed. Null: no light has one. A TrainView of the CUDA rasteriser brings its own.
  const std::uint8_t* visibility_u8 = nullptr;
  std::size_t visibility_stride = 0;  ///< elements from one light's row to the next
  std::uint32_t visibility_rows = 1;
  const std::uint32_t* object_id = nullptr;  ///< [stride]; null: all static
  const std::uint32_t* flags = nullptr;      ///< [stride]; null: all active
  const std::uint64_t* gaussian_id = nullptr;

  [[nodiscard]] bool has_pages() const { return page_shift != kNoPages; }
  /// Of 4-byte elements.
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER std::size_t offset(std::size_t i) const {
    return (i >> page_shift) * page_stride + (i & ((std::size_t{1} << page_shift) - 1));
  }
  /// Of 8-byte elements: gaussian_id.
  [[nodiscard]] std::size_t wide_offset(std::size_t i) const {
    return (i >> page_shift) * (page_stride / 2) + (i & ((std::size_t{1} << page_shift) - 1));
  }
  /// Gaussian i of a channel, a parameter's or of one of the pointers below.
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER const float* at(int channel, std::size_t i) const {
    return parameters + offset(i) + static_cast<std::size_t>(channel) * stride;
  }
  /// Without pages only.
  [[nodiscard]] const float* plane(int channel) const {
    return parameters + static_cast<std::size_t>(channel) * stride;
  }
};

/// The ranges of `gaussians`, which has bounds, that a camera may see (PageFrustum); those of objects that are not in
/// the scene are left out, and those that `surfaces`, in host memory, hide: never the far field's.
[[nodiscard]] std::vector<IndexRange> select_ranges(const GaussiansView& gaussians, const FrustumCamera& camera,
                                                    const Rigid& world_from_camera, const ObjectTransforms& objects,
                                                    const FarthestSurfaces& surfaces = {});

/// Bounds of Gaussians in host memory, for GaussiansView::bounds.
[[nodiscard]] PageBounds bounds_of(const GaussiansView& gaussians, const IndexRange& range);

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
  std::vector<std::uint64_t> gaussian_id;

 private:
  ParameterLayout layout_;
  std::size_t count_ = 0, stride_ = 0;
};

}  // namespace splatbus
