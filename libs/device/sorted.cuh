#pragma once

#include <thrust/binary_search.h>
#include <thrust/execution_policy.h>

#include <cstdint>
#include <cuda/std/functional>

namespace splatbus::device {

/// Index of the element whose key is `key` among `count` that ascend by it, in device memory; -1 when there is none.
/// `key_of` takes an element; without it elements are their own keys.
template <class Element, class Key, class KeyOf = cuda::std::identity>
__device__ inline int find_sorted(const Element* elements, std::uint32_t count, Key key, KeyOf key_of = {}) {
  const auto below = [&](const Element& element, Key wanted) { return key_of(element) < wanted; };
  const Element* const found = thrust::lower_bound(thrust::seq, elements, elements + count, key, below);
  return found != elements + count && key_of(*found) == key ? static_cast<int>(found - elements) : -1;
}

}  // namespace splatbus::device
