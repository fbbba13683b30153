#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <set>
#include <span>
#include <vector>

#include "device/buffer.h"
#include "model/page_store.h"
#include "trainer/commands.h"
#include "trainer/gaussian_kernels.h"
#include "trainer/gradient_step.h"

namespace splatbus::trainer {

/// Every light's visibility of every Gaussian under the last few scene versions, so that a picture trains with its own.
/// It follows the model's structure: until relight has seen it too, a Gaussian that is inserted after a version was
/// computed has what the model itself says of the sun, and sees all of the other lights. A version whose pages several
/// replicas share is there once the parts of all of them have come. In the order of a stream; belongs to one thread.
class VisibilityRing {
 public:
  static constexpr std::size_t kMaxVersions = 128;
  static constexpr std::size_t kMaxBytes = std::size_t{512} << 20;

  VisibilityRing(model::PageStore& store, device::StreamView stream) : store_(store), stream_(stream) {}

  /// Takes a version in; the sun's row of the newest one becomes the model's own visibility. Versions of no use (not in
  /// `needed`, which ascends, and not the newest) go.
  void take(const VisibilityCommand& relit, std::span<const std::uint64_t> needed);
  /// As PageStore's structure has changed, before the moved values are.
  void follow(const kernels::PagedGaussians& fresh, const model::Moves& moves);

  /// By index of the model; null where that version is not there, or of other lights than the scene's. It stays as it
  /// is until the structure changes.
  [[nodiscard]] SceneVisibility find(const SceneState& scene) const;
  /// Ascending.
  [[nodiscard]] std::vector<PairedVersion> versions() const;

 private:
  struct OfIndex {
    std::shared_ptr<std::uint8_t> values;
    std::size_t stride = 0;
    std::vector<std::uint32_t> light_ids;
    std::uint64_t division = 0;
    std::set<std::uint32_t> parts;  ///< of that division, that have come
    bool whole = true;

    [[nodiscard]] std::uint32_t rows() const { return static_cast<std::uint32_t>(light_ids.size()); }
    [[nodiscard]] std::size_t bytes() const { return stride * light_ids.size(); }
    [[nodiscard]] std::uint8_t* row(std::uint32_t light) const { return values.get() + light * stride; }
  };
  /// All lights are seen by all.
  [[nodiscard]] OfIndex make(std::size_t stride, const std::vector<std::uint32_t>& light_ids) const;
  [[nodiscard]] OfIndex of_model(const std::vector<std::uint32_t>& light_ids) const;
  void drop(std::span<const std::uint64_t> needed);

  model::PageStore& store_;
  device::StreamView stream_;
  std::map<std::uint64_t, OfIndex> of_version_;
};

}  // namespace splatbus::trainer
