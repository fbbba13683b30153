#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <span>
#include <vector>

#include "device/buffer.h"
#include "model/page_store.h"
#include "trainer/commands.h"
#include "trainer/gaussian_kernels.h"

namespace splatbus::trainer {

/// The sun's visibility of every Gaussian under the last few scene versions, so that a picture trains with its own. It
/// follows the model's structure: a Gaussian that is inserted after a version was computed has what the model itself
/// says of it until relight has seen it too. In the order of a stream; belongs to one thread.
class VisibilityRing {
 public:
  static constexpr std::size_t kMaxVersions = 128;
  static constexpr std::size_t kMaxBytes = std::size_t{512} << 20;

  VisibilityRing(model::PageStore& store, device::StreamView stream) : store_(store), stream_(stream) {}

  /// Takes a version in; the newest one becomes the model's own visibility. Versions of no use (not in `needed`, which
  /// ascends, and not the newest) go.
  void take(const VisibilityCommand& relit, std::span<const std::uint64_t> needed);
  /// As PageStore's structure has changed, before the moved values are.
  void follow(const kernels::PagedGaussians& fresh, const model::Moves& moves);

  /// By index of the model; null where that version is not there. It stays as it is until the structure changes.
  [[nodiscard]] std::shared_ptr<const std::uint8_t> find(std::uint64_t scene_version) const;
  /// Ascending.
  [[nodiscard]] std::vector<std::uint64_t> versions() const;

 private:
  struct OfIndex {
    std::shared_ptr<std::uint8_t> values;
    std::size_t size = 0;
  };
  [[nodiscard]] OfIndex make(std::size_t size) const;
  void drop(std::span<const std::uint64_t> needed);

  model::PageStore& store_;
  device::StreamView stream_;
  std::map<std::uint64_t, OfIndex> of_version_;
};

}  // namespace splatbus::trainer
