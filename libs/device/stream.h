#pragma once

#include "device/device.h"

struct CUstream_st;  // what cudaStream_t points to

namespace splatbus::device {

/// An ordered queue of work on one device, owned by somebody else: cheap to copy. On the CPU whatever is enqueued has
/// finished when the call returns.
struct StreamView {
  Device device = Device::Cpu;
  CUstream_st* cuda = nullptr;  ///< a cudaStream_t; null on the CPU, and for CUDA's legacy stream

  /// Until all that was enqueued has been done. Throws std::runtime_error with what CUDA says.
  void wait() const;
  [[nodiscard]] bool on_cuda() const { return device == Device::Cuda; }
};

/// The calling thread's own stream of a device, which lives as long as the process. Copies of the bus run on it too.
[[nodiscard]] StreamView thread_stream(Device device);

/// Owner of a stream that waits for no other. Throws std::runtime_error when the device cannot be had.
class Stream {
 public:
  explicit Stream(Device device = Device::Cuda);
  ~Stream();
  Stream(Stream&& other) noexcept : view_(other.view_) { other.view_ = {}; }
  Stream& operator=(Stream&&) = delete;

  [[nodiscard]] CUstream_st* get() const { return view_.cuda; }
  [[nodiscard]] StreamView view() const { return view_; }
  operator StreamView() const { return view_; }  // NOLINT(google-explicit-constructor): an owner is used as its view
  void wait() const { view_.wait(); }

 private:
  StreamView view_;
};

}  // namespace splatbus::device
