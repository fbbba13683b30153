#pragma once

#include <cmath>
#include <cstdint>
#include <map>
#include <random>
#include <set>
#include <stdexcept>
#include <tuple>
#include <vector>

#include "device/buffer.h"
#include "model/page_store.h"

namespace splatbus::model {

/// Rows of a batch in host memory.
struct Batch {
  std::size_t count = 0;
  std::vector<float> mean, log_scale, rotation, opacity_logit, albedo, normal, visibility;
  std::vector<std::uint32_t> object_id;
};

/// Around one point, or all over, in one of `frames`.
inline Batch make_batch(std::mt19937& random, std::size_t count, bool clustered, std::uint32_t frames) {
  Batch batch{.count = count};
  std::uniform_real_distribution<float> spread(-20, 20), unit(0, 1);
  std::normal_distribution<float> near(0, 0.05F);
  const float center[3] = {spread(random), spread(random), spread(random)};
  const auto frame = static_cast<std::uint32_t>(random() % frames);
  const auto fill = [&](std::vector<float>& planes, std::size_t channels) {
    planes.resize(channels * count);
    for (float& value : planes) value = unit(random);
  };
  fill(batch.mean, 3);
  for (std::size_t c = 0; c < 3; ++c) {
    for (std::size_t k = 0; k < count; ++k) {
      batch.mean[c * count + k] = clustered ? center[c] + near(random) : spread(random);
    }
  }
  fill(batch.log_scale, 3);
  fill(batch.rotation, 4);
  fill(batch.opacity_logit, 1);
  fill(batch.albedo, 3);
  fill(batch.normal, 3);
  fill(batch.visibility, 1);
  for (std::size_t k = 0; k < count; ++k) {
    batch.object_id.push_back(clustered ? frame : static_cast<std::uint32_t>(random() % frames));
  }
  return batch;
}

/// A Gaussian by itself: what is in the rows of floats, in their order.
struct Gaussian {
  std::uint32_t frame_id = 0;
  std::vector<float> values;
  bool operator==(const Gaussian&) const = default;
};

/// What should be in a model of the layout Transfer, kept apart from it by id.
class Truth {
 public:
  void insert(const Batch& batch, std::size_t count) {
    for (std::size_t k = 0; k < count; ++k) {
      std::vector<float> parameters;
      const auto take = [&](std::vector<float>& to, const std::vector<float>& planes, std::size_t channels) {
        for (std::size_t c = 0; c < channels; ++c) to.push_back(planes[c * batch.count + k]);
      };
      take(parameters, batch.mean, 3);
      take(parameters, batch.log_scale, 3);
      take(parameters, batch.rotation, 4);
      take(parameters, batch.opacity_logit, 1);
      take(parameters, batch.albedo, 3);
      parameters.resize(41, 0.0F);
      Gaussian gaussian{.frame_id = batch.object_id[k], .values = parameters};
      gaussian.values.insert(gaussian.values.end(), parameters.begin(), parameters.end());
      take(gaussian.values, batch.normal, 3);
      take(gaussian.values, batch.mean, 3);
      take(gaussian.values, batch.visibility, 1);
      gaussians[next_id++] = std::move(gaussian);
    }
  }
  void duplicate(const std::vector<std::uint64_t>& ids) {
    for (const std::uint64_t id : ids) gaussians[next_id++] = Gaussian(gaussians.at(id));
  }
  void remove(const std::vector<std::uint64_t>& ids) {
    for (const std::uint64_t id : ids) gaussians.erase(id);
  }

  std::map<std::uint64_t, Gaussian> gaussians;
  std::uint64_t next_id = 1;
};

/// What a store holds, read from its pages and its table.
struct Found {
  struct Place {
    std::uint32_t index = 0;
    Gaussian gaussian;
  };
  std::map<std::uint64_t, Place> by_id;

  explicit Found(const PageStore& store) {
    const std::size_t words = page_words(store.layout());
    const std::uint32_t id_row = rows_of(Channel::GaussianId, store.layout()).first;
    std::vector<std::uint32_t> page_words_read(words);
    const device::Stream stream(store.device());
    for (std::uint32_t page = 0; page < store.table().page_capacity(); ++page) {
      const PageEntry& entry = store.table().entry(page);
      if (entry.generation % 2 != 0) throw std::logic_error("page " + std::to_string(page) + " is open");
      if (!is_present(entry.now.state)) continue;
      if (entry.now.count == 0) throw std::logic_error("page " + std::to_string(page) + " is empty");
      device::copy(stream, page_words_read.data(), store.memory().words + page * words, words * 4);
      stream.wait();
      const auto* const ids =
          reinterpret_cast<const std::uint64_t*>(page_words_read.data() + std::size_t{id_row} * kRowWords);
      const auto* const values = reinterpret_cast<const float*>(page_words_read.data());
      for (std::uint32_t lane = 0; lane < entry.now.count; ++lane) {
        Place place{page * kPageLanes + lane, {.frame_id = entry.now.frame_id, .values = {}}};
        for (std::uint32_t row = 0; row < id_row; ++row)
          place.gaussian.values.push_back(values[row * kRowWords + lane]);
        if (!by_id.emplace(ids[lane], std::move(place)).second) {
          throw std::logic_error("Gaussian " + std::to_string(ids[lane]) + " is there twice");
        }
      }
    }
  }
};

/// Bit by bit: x's lowest bit is the key's.
inline std::uint64_t slow_key(const float* position_m) {
  std::uint64_t key = 0;
  for (unsigned axis = 0; axis < 3; ++axis) {
    const auto cell = static_cast<std::int64_t>(std::floor(position_m[axis] * 100.0F)) + (1 << 20);
    for (unsigned bit = 0; bit < 21; ++bit) key |= (static_cast<std::uint64_t>(cell) >> bit & 1U) << (3 * bit + axis);
  }
  return key;
}

template <class T>
std::vector<T> to_host(Device device, const T* from, std::size_t count) {
  std::vector<T> result(count);
  const device::Stream stream(device);
  device::copy(stream, result.data(), from, count * sizeof(T));
  stream.wait();
  return result;
}

/// A batch's rows where a store wants them.
class RowsOnDevice {
 public:
  RowsOnDevice(Device device, const Batch& batch) : stream_(device), object_id_(stream_) {
    rows.stride = batch.count;
    rows.mean = put(batch.mean);
    rows.log_scale = put(batch.log_scale);
    rows.rotation = put(batch.rotation);
    rows.opacity_logit = put(batch.opacity_logit);
    rows.albedo = put(batch.albedo);
    rows.normal = put(batch.normal);
    rows.visibility = put(batch.visibility);
    object_id_.assign(std::span(batch.object_id));
    stream_.wait();
    rows.object_id = object_id_.data();
  }
  InsertRows rows;

 private:
  const float* put(const std::vector<float>& planes) {
    floats_.emplace_back(stream_.view()).assign(std::span(planes));
    return floats_.back().data();
  }
  device::Stream stream_;
  std::vector<device::Buffer<float>> floats_;
  device::Buffer<std::uint32_t> object_id_;
};

inline InsertResult insert(PageStore& store, const Batch& batch, std::uint64_t number, std::uint64_t epoch = 1) {
  const RowsOnDevice rows(store.device(), batch);
  return store.insert(rows.rows, batch.count, {}, epoch, number);
}

inline InsertResult duplicate(PageStore& store, const std::vector<std::uint32_t>& indices) {
  const device::Stream stream(store.device());
  device::Buffer<std::uint32_t> on_device(stream.view());
  on_device.assign(std::span(indices));
  stream.wait();
  return store.duplicate(on_device.data(), indices.size());
}

inline RemoveResult remove(PageStore& store, const std::vector<std::uint32_t>& indices) {
  std::vector<std::uint8_t> dead(store.view().count, 0);
  for (const std::uint32_t index : indices) dead.at(index) = 1;
  const device::Stream stream(store.device());
  device::Buffer<std::uint8_t> on_device(stream.view());
  on_device.assign(std::span(std::as_const(dead)));
  stream.wait();
  return store.remove(on_device.data());
}

}  // namespace splatbus::model
