#pragma once

#include <cuda_runtime_api.h>

#include "device/check.h"

namespace splatbus::raster::cuda {

/// Work that is enqueued often, as a graph. It is captured at its second launch after a change, for what changes with
/// every launch is not worth it.
class Graph {
 public:
  Graph() = default;
  ~Graph() { destroy(); }
  Graph(const Graph&) = delete;
  Graph& operator=(const Graph&) = delete;

  /// What it launches has changed.
  void invalidate() {
    captured_ = false;
    launches_ = 0;
  }

  /// `enqueue` enqueues the work on `stream`, with no synchronisation and no allocation.
  template <class Enqueue>
  void launch(cudaStream_t stream, Enqueue&& enqueue) {
    if (!captured_ && launches_++ == 0) return enqueue();
    if (!captured_) capture(stream, enqueue);
    device::check(cudaGraphLaunch(executable_, stream), "launching a step");
  }

 private:
  template <class Enqueue>
  void capture(cudaStream_t stream, Enqueue& enqueue) {
    cudaGraph_t graph = nullptr;
    device::check(cudaStreamBeginCapture(stream, cudaStreamCaptureModeThreadLocal), "capturing a step");
    try {
      enqueue();
    } catch (...) {
      cudaStreamEndCapture(stream, &graph);
      if (graph != nullptr) cudaGraphDestroy(graph);
      throw;
    }
    device::check(cudaStreamEndCapture(stream, &graph), "capturing a step");
    destroy();
    const cudaError_t status = cudaGraphInstantiate(&executable_, graph, 0);
    cudaGraphDestroy(graph);
    device::check(status, "making a step's graph");
    captured_ = true;
  }

  void destroy() {
    if (executable_ != nullptr) cudaGraphExecDestroy(executable_);
    executable_ = nullptr;
  }

  cudaGraphExec_t executable_ = nullptr;
  bool captured_ = false;
  int launches_ = 0;
};

}  // namespace splatbus::raster::cuda
