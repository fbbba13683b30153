#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <vector>

#include "expander/insertion.h"
#include "expander/round.h"
#include "model/published_model.h"

namespace splatbus::expander {

/// New Gaussians for one model/insert. Copies share the channels, which nobody changes once the batch is made.
struct InsertBatch {
  std::uint64_t batch = 0;  ///< unique within this process
  std::int64_t capture_ns = 0;
  SceneState scene;  ///< of the samples
  std::uint32_t count = 0;
  Device memory = Device::Cpu;      ///< of `data`
  std::shared_ptr<std::byte> data;  ///< insert_channels_at(data, count) says what lies where

  [[nodiscard]] std::size_t size() const { return count; }
  [[nodiscard]] std::size_t bytes() const { return count * kInsertBytes; }
  [[nodiscard]] InsertChannels channels() const { return insert_channels_at(data.get(), count); }
};

/// A batch of `count` Gaussians whose channels are still to be written.
[[nodiscard]] InsertBatch allocate_batch(device::StreamView stream, std::uint32_t count);

struct InsertOptions {
  SelectOptions select;
  InitialOptions initial;
  std::size_t batch_size = 65536;  ///< most Gaussians of a batch
};

struct InsertResult {
  std::size_t selected = 0;          ///< Gaussians of all batches
  std::vector<CellCount> cells;      ///< candidates, and how many samples the round has in each
  std::vector<InsertBatch> batches;  ///< in the order of the round; not numbered
};

/// Knows what is modelled, and makes Gaussians of the samples that are not, on one device. Rounds, batches and models
/// live on that device. Used by one thread, which also lets rounds and batches go. Throws as insertion.h: what is
/// modelled is then unknown.
class GaussianInserter {
 public:
  GaussianInserter(Device device, float cell_size_m);

  [[nodiscard]] Device memory() const { return stream_.device; }

  /// take_round() to this device.
  [[nodiscard]] std::unique_ptr<Round> take(const IncomingRound& incoming) {
    return take_round(incoming, stream_, host_bytes_);
  }

  /// Makes Gaussians of what the round shows and the model lacks (SampleSelector::select has the rules), and remembers
  /// them as modelled. The batches are complete: no stream writes them any more.
  [[nodiscard]] InsertResult insert(const Round& round, const InsertOptions& options);

  /// Marks the batches' points as modelled.
  void add(std::span<const InsertBatch* const> batches);
  /// True when any point of the batch is modelled, to the last bit.
  [[nodiscard]] bool holds_any(const InsertBatch& batch) const { return modelled_.holds_any(batch.channels()); }
  /// Marks a live model's points as modelled, and nothing else. False, and nothing is changed, when its structure moved
  /// on meanwhile. The model was opened in memory().
  [[nodiscard]] bool adopt(const PublishedModel& model);
  void clear() { modelled_.clear(); }

  /// Cells that hold modelled points, ascending.
  [[nodiscard]] std::vector<CellCount> cells() const { return modelled_.cells(); }
  [[nodiscard]] std::size_t modelled_points() const { return modelled_.size(); }

  /// Bulk data that has passed through host memory. Any thread.
  [[nodiscard]] std::uint64_t host_copied_bytes() const { return host_bytes_; }

 private:
  device::StreamView stream_;
  PointGrid modelled_, adopted_;
  SampleSelector selector_;
  std::atomic<std::uint64_t> host_bytes_{0};
};

}  // namespace splatbus::expander
