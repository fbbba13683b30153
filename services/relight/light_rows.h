#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "device/buffer.h"
#include "relight/map_ring.h"
#include "relight/visibility.h"

namespace splatbus::relight {

/// A light of a scene and the maps it is tested with; null: it casts no shadow.
struct LightOfScene {
  LightSource source;
  std::shared_ptr<const LightMaps> maps;
};

/// The sun, then the other lights of a scene, each that casts shadows with its maps; nullopt while one has not all.
[[nodiscard]] std::optional<std::vector<LightOfScene>> find_lights(const Light& light, const MapRing& maps);

/// As compute_visibility() takes them; good while the maps are.
[[nodiscard]] std::vector<MappedLight> mapped(std::span<const LightOfScene> lights);

/// A model in pages as relight reads it.
struct PagedModel {
  GaussiansView gaussians;
  std::span<const std::uint64_t> page_generations;  ///< of each range's page
  std::uint64_t step = 0;                           ///< of training
};

/// Computes visibility and skips what a change cannot reach: of a light whose parameters and maps are those of the
/// result before, the Gaussians of pages whose structure and whose frame's transform are the same. Scales go on
/// training, so that a page is computed again when the steps since are a quarter of all. In the order of a stream;
/// belongs to one thread.
class LightRows {
 public:
  explicit LightRows(device::StreamView stream) : stream_(stream), now_(stream), before_(stream) {}

  /// [lights][count] on the device, there until the next call. Throws as compute_visibility().
  const std::uint8_t* compute(const PagedModel& model, const ObjectTransforms& objects,
                              std::span<const LightOfScene> lights, const VisibilityOptions& options);
  /// Of another model, or what was read was none.
  void forget();

  /// Pages times lights, in all.
  [[nodiscard]] std::uint64_t computed() const { return computed_; }
  [[nodiscard]] std::uint64_t skipped() const { return skipped_; }

 private:
  struct Page {
    std::uint64_t generation = ~std::uint64_t{0};  ///< that no page has
    std::optional<ObjectTransform> frame;
    bool operator==(const Page&) const = default;
  };
  struct Row {
    LightSource source;
    std::uint64_t maps_revision = 0;
    std::vector<std::uint64_t> step;  ///< of each page: when it was computed
  };
  /// A result.
  struct Rows {
    explicit Rows(device::StreamView stream) : values(stream) {}
    device::Buffer<std::uint8_t> values;
    std::size_t count = 0;
    VisibilityOptions options;
    std::vector<Page> pages;
    std::vector<Row> rows;
  };
  [[nodiscard]] std::int32_t row_before(const Row& row) const;

  device::StreamView stream_;
  Rows now_, before_;
  std::uint64_t computed_ = 0, skipped_ = 0;
};

}  // namespace splatbus::relight
