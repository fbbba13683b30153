#pragma once

#include <array>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <thread>
#include <vector>

#include "viewer/gl/batch.h"
#include "viewer/gl/splat_renderer.h"

namespace splatbus::viewer::gl {

/// From where rows are sorted.
struct SortView {
  std::array<float, 4> view_z{};  ///< depth = dot(view_z, (point_world, 1)), metres
  float near_m = 0.05F;
  std::vector<Transform> transforms;
  std::uint32_t far_field = 0;
  bool operator==(const SortView&) const = default;
};

/// Sorts rows by depth on a thread of its own; the newest view wins.
class SortThread {
 public:
  SortThread();
  ~SortThread();
  SortThread(const SortThread&) = delete;
  SortThread& operator=(const SortThread&) = delete;

  void add(SharedBatch batch);
  void look(SortView view);

  struct Sorted {
    std::vector<std::uint32_t> order;  ///< rows, farthest first
    std::uint64_t batches = 0;         ///< that it knows, of all that were added
    std::uint64_t views = 0;           ///< the same of look()
    double sort_ms = 0;
  };
  /// False where nothing was sorted since.
  [[nodiscard]] bool take(Sorted& sorted);
  /// Until it has sorted all that was given.
  void wait();

 private:
  void run();

  std::mutex mutex_;  // of all below but the thread
  std::condition_variable due_, done_;
  bool stop_ = false, sorted_is_new_ = false;
  std::vector<SharedBatch> batches_;
  std::uint64_t added_ = 0, looks_ = 0;
  SortView view_;
  Sorted sorted_;
  std::thread thread_;
};

}  // namespace splatbus::viewer::gl
