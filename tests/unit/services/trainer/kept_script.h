#pragma once

#include "../../model/truth.h"

namespace splatbus::trainer {

inline constexpr std::size_t kKeptGaussians = 40000;

/// Change number `change` of a model that never rests and never grows large, in the truth and, unless null, in a store.
inline void change_model(std::size_t change, model::PageStore* store, model::Truth& truth) {
  std::mt19937 random(static_cast<unsigned>(change) + 17);
  std::vector<std::uint64_t> ids;
  const auto choose = [&](std::size_t of, std::size_t which) {
    for (const auto& [id, gaussian] : truth.gaussians) {
      if (id % of == which) ids.push_back(id);
    }
    std::vector<std::uint32_t> indices;
    if (store == nullptr) return indices;
    const model::Found found(*store);
    for (const std::uint64_t id : ids) indices.push_back(found.by_id.at(id).index);
    return indices;
  };
  switch (change % 5) {
    case 0:
    case 1: {
      const model::Batch batch = model::make_batch(random, 1200, change % 2 == 0, 2);
      truth.insert(batch, batch.count);
      if (store != nullptr) insert(*store, batch, change + 1);
      return;
    }
    case 2: {
      const auto indices = choose(9, change % 9);
      if (store != nullptr) duplicate(*store, indices);
      return truth.duplicate(ids);
    }
    case 3: {
      const auto indices = choose(3, change % 3);
      if (store != nullptr) remove(*store, indices);
      return truth.remove(ids);
    }
    default:
      if (store != nullptr) store->merge();
  }
}

}  // namespace splatbus::trainer
