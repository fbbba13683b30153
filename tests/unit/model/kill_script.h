#pragma once

#include <cstdint>
#include <stdexcept>
#include <vector>

#include "truth.h"

namespace splatbus::model {

inline constexpr std::size_t kScriptGaussians = 40000;
/// Insertion into nothing, appends, splits with appends and a new frame, copies with splits, a removal that empties a
/// page, once more of what there is by then, a merge
/// of what another has left sparse, and frozen pages that something is removed from and put into.
inline constexpr std::size_t kScriptChanges = 12;

/// Makes a change of a story that is always the same, in the truth and, unless null, in a store.
inline void make_change(std::size_t change, PageStore* store, Truth& truth) {
  std::mt19937 random(static_cast<unsigned>(change) + 3);
  const auto insert_batch = [&](std::size_t count, bool clustered, std::uint32_t frames) {
    const Batch batch = make_batch(random, count, clustered, frames);
    truth.insert(batch, count);
    if (store != nullptr) insert(*store, batch, change);
  };
  std::vector<std::uint64_t> ids;
  const auto choose = [&](auto&& wanted) {
    for (const auto& [id, gaussian] : truth.gaussians) {
      if (wanted(id, gaussian)) ids.push_back(id);
    }
    std::vector<std::uint32_t> indices;
    if (store == nullptr) return indices;
    const Found found(*store);
    for (const std::uint64_t id : ids) indices.push_back(found.by_id.at(id).index);
    return indices;
  };
  switch (change) {
    case 0:
      return insert_batch(4000, false, 2);
    case 1:
      return insert_batch(200, false, 2);
    case 2:
      return insert_batch(2500, false, 3);
    case 3: {
      const auto indices = choose([](std::uint64_t id, const Gaussian&) { return id % 3 == 0; });
      if (store != nullptr) duplicate(*store, indices);
      return truth.duplicate(ids);
    }
    case 4: {  // all of a frame, and some of the others
      const auto indices =
          choose([](std::uint64_t id, const Gaussian& gaussian) { return gaussian.frame_id == 2 || id % 4 == 1; });
      if (store != nullptr) remove(*store, indices);
      return truth.remove(ids);
    }
    case 5:
      return insert_batch(1500, true, 1);
    case 6:
    case 7:
    case 10: {
      const auto indices = choose([&](std::uint64_t id, const Gaussian&) {
        if (change == 10) return id % 7 == 3;
        return change == 6 ? id % 5 == 2 : id % 8 != 0;
      });
      if (store != nullptr) remove(*store, indices);
      return truth.remove(ids);
    }
    case 8:
      if (store != nullptr && store->merge().count == 0) throw std::logic_error("nothing was sparse");
      return;
    case 9: {
      if (store == nullptr) return;
      std::vector<std::uint32_t> pages;
      for (const IndexRange& range : store->view().ranges) pages.push_back(range.first / kPageLanes);
      store->freeze(pages);
      return;
    }
    case 11:
      return insert_batch(900, false, 2);
    default:
      throw std::logic_error("no such change");
  }
}

}  // namespace splatbus::model
