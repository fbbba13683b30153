#pragma once

#include <algorithm>
#include <cstdint>
#include <map>
#include <span>
#include <vector>

#include "gaussians/model.h"
#include "model/page_store.h"
#include "sample_batch.h"

namespace splatbus::trainer {

/// What pages hold, in host memory: Gaussians in the order of their ids, however they lie.
class HostModel {
 public:
  explicit HostModel(const model::PageStore& store)
      : HostModel(store.layout(), store.view().ranges,
                  to_host(store.device(), store.memory().words,
                          (store.view().count + kPageLanes - 1) / kPageLanes * model::page_words(store.layout()))) {}

  HostModel(const ParameterLayout& layout, std::span<const IndexRange> ranges, std::vector<std::uint32_t> words)
      : live_(layout), average_(layout) {
    const model::PageMemory memory(reinterpret_cast<std::byte*>(words.data()), layout);
    for (const IndexRange& range : ranges) {
      for (std::uint32_t i = range.first; i < range.first + range.count; ++i) {
        index_of_[*memory.wide(memory.gaussian_id, i)] = i;
        frame_of_[i] = range.frame_id;
        ++listed_;
      }
    }
    fill(live_, memory, 0);
    fill(average_, memory, static_cast<std::uint32_t>(layout.channels()));
  }

  [[nodiscard]] std::size_t count() const { return live_.count(); }
  /// Indices that hold Gaussians: more than count() when an id is there twice.
  [[nodiscard]] std::size_t listed() const { return listed_; }
  [[nodiscard]] GaussiansView live() const { return live_.view(); }
  [[nodiscard]] GaussiansView average() const { return average_.view(); }
  [[nodiscard]] const std::vector<std::uint64_t>& ids() const { return live_.gaussian_id; }
  [[nodiscard]] float at(int channel, std::size_t k) const { return live_.view().plane(channel)[k]; }
  /// Where Gaussian number k lies in the pages.
  [[nodiscard]] std::uint32_t index(std::size_t k) const { return index_of_.at(live_.gaussian_id[k]); }

 private:
  void fill(GaussiansBuffer& to, const model::PageMemory& memory, std::uint32_t first_row) const {
    to.resize(index_of_.size());
    std::size_t k = 0;
    for (const auto& [id, i] : index_of_) {
      const auto take = [&, i = i](std::vector<float>& planes, std::uint32_t row, std::size_t rows) {
        for (std::uint32_t c = 0; c < rows; ++c) planes[c * to.stride() + k] = *memory.value(row + c, i);
      };
      take(to.parameters, first_row, static_cast<std::size_t>(to.layout().channels()));
      take(to.normal, memory.normal, 3);
      take(to.surface_point, memory.surface_point, 3);
      take(to.visibility, memory.visibility, 1);
      to.object_id[k] = frame_of_.at(i);
      to.gaussian_id[k] = id;
      ++k;
    }
  }

  std::map<std::uint64_t, std::uint32_t> index_of_;
  std::map<std::uint32_t, std::uint32_t> frame_of_;
  std::size_t listed_ = 0;
  GaussiansBuffer live_, average_;
};

/// Writes one parameter of the Gaussian at an index.
inline void poke(model::PageStore& store, int channel, std::uint32_t index, float value) {
  bus::copy_memory(store.memory().value(static_cast<std::uint32_t>(channel), index), store.device(), &value,
                   Device::Cpu, sizeof(value));
  bus::finish_copies();
  store.refresh_bounds();
}

}  // namespace splatbus::trainer
