#pragma once

#include <cuda_runtime_api.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <string>
#include <vector>

#include "../../bus/bus_fixture.h"
#include "bus/memory.h"
#include "sample_batch.h"
#include "trainer/model_store.h"

namespace splatbus::trainer {

inline bool has_device() {
  int count = 0;
  return cudaGetDeviceCount(&count) == cudaSuccess && count > 0;
}

/// The first columns of a store's planes, in host memory.
class HostPlanes {
 public:
  explicit HostPlanes(const ModelStore& store)
      : memory_(bus::allocate_memory(Device::Cpu, SlabLayout(store.layout(), store.capacity()).bytes)),
        planes_(store.layout(), store.capacity(), memory_.get()),
        count_(store.count()) {
    copy_columns(planes_, Device::Cpu, store.planes(), store.memory(), count_);
  }
  [[nodiscard]] const ModelPlanes* operator->() const { return &planes_; }
  [[nodiscard]] const ModelPlanes& operator*() const { return planes_; }
  [[nodiscard]] std::size_t count() const { return count_; }
  [[nodiscard]] std::vector<std::uint64_t> ids() const { return {planes_.gaussian_id, planes_.gaussian_id + count_}; }

 private:
  std::shared_ptr<std::byte> memory_;
  ModelPlanes planes_;
  std::size_t count_;
};

template <class T>
void expect_same_planes(const char* name, const T* a, std::size_t a_stride, const T* b, std::size_t b_stride,
                        int channels, std::size_t count, double tolerance) {
  for (std::size_t c = 0; c < static_cast<std::size_t>(channels); ++c) {
    for (std::size_t i = 0; i < count; ++i) {
      const T left = a[c * a_stride + i];
      const T right = b[c * b_stride + i];
      if (left == right) continue;
      const double off = std::abs(static_cast<double>(left) - static_cast<double>(right));
      ASSERT_LE(off, tolerance) << name << " channel " << c << " column " << i << ": " << left << " and " << right;
    }
  }
}

inline void expect_same(const HostPlanes& a, const HostPlanes& b, double tolerance = 0) {
  ASSERT_EQ(a.count(), b.count());
  const std::size_t n = a.count();
  const std::size_t s = a->capacity;
  const std::size_t t = b->capacity;
  const int channels = a->layout.channels();
  expect_same_planes("parameters", a->parameters, s, b->parameters, t, channels, n, tolerance);
  expect_same_planes("average", a->average, s, b->average, t, channels, n, tolerance);
  expect_same_planes("normal", a->normal, s, b->normal, t, 3, n, 0);
  expect_same_planes("surface_point", a->surface_point, s, b->surface_point, t, 3, n, 0);
  expect_same_planes("visibility", a->visibility, s, b->visibility, t, 1, n, 0);
  expect_same_planes("object_id", a->object_id, s, b->object_id, t, 1, n, 0);
  expect_same_planes("flags", a->flags, s, b->flags, t, 1, n, 0);
  expect_same_planes("cell", a->cell, s, b->cell, t, 1, n, 0);
  expect_same_planes("gaussian_id", a->gaussian_id, s, b->gaussian_id, t, 1, n, 0);
}

/// An array in a kind of memory.
template <class T>
class Placed {
 public:
  Placed(const std::vector<T>& values, Device memory)
      : memory_(bus::allocate_memory(memory, values.size() * sizeof(T))) {
    bus::copy_memory(memory_.get(), memory, values.data(), Device::Cpu, values.size() * sizeof(T));
    bus::finish_copies();
  }
  [[nodiscard]] const T* data() const { return reinterpret_cast<const T*>(memory_.get()); }

 private:
  std::shared_ptr<std::byte> memory_;
};

template <class T>
std::vector<T> host_copy(const T* from, Device memory, std::size_t count) {
  std::vector<T> values(count);
  bus::copy_memory(values.data(), Device::Cpu, from, memory, count * sizeof(T));
  bus::finish_copies();
  return values;
}

}  // namespace splatbus::trainer
