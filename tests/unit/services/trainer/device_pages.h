#pragma once

#include <gtest/gtest.h>

#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "sample_batch.h"
#include "trainer/gaussian_kernels.h"

namespace splatbus::trainer::kernels {

/// Pages of a Transfer model in host memory, on which kernels run on a device.
class Pages {
 public:
  Pages(Device device, std::vector<IndexRange> of)
      : ranges(std::move(of)), words((ranges.back().first / kPageLanes + 1) * model::page_words({})), stream_(device) {}

  float& at(std::uint32_t row, std::uint32_t i) { return *memory().value(row, i); }
  [[nodiscard]] model::PageMemory memory() { return {reinterpret_cast<std::byte*>(words.data()), {}}; }
  [[nodiscard]] std::uint32_t indices() const { return ranges.back().first + kPageLanes; }

  /// Calls run(stream, gaussians) with the pages on the device.
  template <class Run>
  void run(Run&& run, std::uint32_t active_channels = 41) {
    device::Buffer<std::uint32_t> on_device(stream_);
    device::Buffer<IndexRange> device_ranges(stream_);
    on_device.assign(std::span(std::as_const(words)));
    device_ranges.assign(std::span(std::as_const(ranges)));
    run(stream_.view(), PagedGaussians{.memory = {reinterpret_cast<std::byte*>(on_device.data()), {}},
                                       .channels = 41,
                                       .active_channels = active_channels,
                                       .ranges = device_ranges.data(),
                                       .range_count = static_cast<std::uint32_t>(ranges.size())});
    words = on_device.to_host();
  }
  template <class T>
  device::Buffer<T> place(const std::vector<T>& values) {
    device::Buffer<T> buffer(stream_);
    buffer.assign(std::span(values));
    stream_.wait();
    return buffer;
  }

  std::vector<IndexRange> ranges;
  std::vector<std::uint32_t> words;

 private:
  device::Stream stream_;
};

/// On either device.
class KernelsOn : public testing::TestWithParam<Device> {
 protected:
  void SetUp() override {
    if (!has_device(GetParam())) GTEST_SKIP() << "no such device";
  }
  Pages make_pages(std::vector<IndexRange> ranges) { return {GetParam(), std::move(ranges)}; }
};

}  // namespace splatbus::trainer::kernels
