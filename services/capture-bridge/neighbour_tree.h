#pragma once

#include "capture-bridge/surfel.h"

namespace splatbus::capture_bridge {

struct Box {
  Vec3 low{INFINITY, INFINITY, INFINITY};
  Vec3 high{-INFINITY, -INFINITY, -INFINITY};
};

SPLATBUS_PORTABLE Box united(const Box& a, const Box& b) {
  return {{smaller(a.low.x, b.low.x), smaller(a.low.y, b.low.y), smaller(a.low.z, b.low.z)},
          {larger(a.high.x, b.high.x), larger(a.high.y, b.high.y), larger(a.high.z, b.high.z)}};
}

/// 0 within the box; never more than the distance to any point of it, as floats round.
SPLATBUS_PORTABLE float distance2(const Box& box, const Vec3& p) {
  const Vec3 d{larger(larger(box.low.x - p.x, p.x - box.high.x), 0),
               larger(larger(box.low.y - p.y, p.y - box.high.y), 0),
               larger(larger(box.low.z - p.z, p.z - box.high.z), 0)};
  return dot(d, d);
}

/// Between boxes; never more than that of any point of the one to the other.
SPLATBUS_PORTABLE float distance2(const Box& a, const Box& b) {
  const Vec3 d{larger(larger(a.low.x - b.high.x, b.low.x - a.high.x), 0),
               larger(larger(a.low.y - b.high.y, b.low.y - a.high.y), 0),
               larger(larger(a.low.z - b.high.z, b.low.z - a.high.z), 0)};
  return dot(d, d);
}

/// The nearest points to one of them, by distance, those as far by index: whatever the order of looking, the same.
template <int kCount>
struct Nearest {
  float distance2[kCount];
  std::uint32_t index[kCount];
  int found = 0;

  SPLATBUS_PORTABLE Nearest() {
    for (int k = 0; k < kCount; ++k) {
      distance2[k] = INFINITY;
      index[k] = 0xFFFFFFFF;
    }
  }
  [[nodiscard]] SPLATBUS_PORTABLE float farthest2() const { return distance2[kCount - 1]; }

  SPLATBUS_PORTABLE void add(float d2, std::uint32_t i) {
    if (!before(d2, i, distance2[kCount - 1], index[kCount - 1])) return;
#ifdef __CUDA_ARCH__
    // Constant indices throughout, so that the arrays stay in registers.
    for (int k = kCount - 1; k > 0; --k) {
      if (before(d2, i, distance2[k - 1], index[k - 1])) {
        distance2[k] = distance2[k - 1];
        index[k] = index[k - 1];
      } else if (before(d2, i, distance2[k], index[k])) {
        distance2[k] = d2;
        index[k] = i;
      }
    }
    if (before(d2, i, distance2[0], index[0])) {
      distance2[0] = d2;
      index[0] = i;
    }
#else
    int k = kCount - 1;
    for (; k > 0 && before(d2, i, distance2[k - 1], index[k - 1]); --k) {
      distance2[k] = distance2[k - 1];
      index[k] = index[k - 1];
    }
    distance2[k] = d2;
    index[k] = i;
#endif
    found += found < kCount ? 1 : 0;
  }

 private:
  SPLATBUS_PORTABLE static bool before(float d2, std::uint32_t i, float other_d2, std::uint32_t other_i) {
    return d2 < other_d2 || (d2 == other_d2 && i < other_i);
  }
};

/// A balanced binary tree of boxes over points in Morton order, kLeafPoints a leaf: node 1 is the root, the children of
/// node n are 2n and 2n + 1, leaf l is node `leaves` + l. The answers are right in any order of the points, but only a
/// curve that keeps near points together makes them quick.
struct NeighbourTree {
  static constexpr std::uint32_t kLeafPoints = 16;

  const float* points = nullptr;  ///< [count, 3]
  std::uint32_t count = 0;
  std::uint32_t leaves = 0;  ///< a power of two
  Box* nodes = nullptr;      ///< [2 * leaves]

  /// Leaves of a tree over so many points, at least 2.
  [[nodiscard]] SPLATBUS_PORTABLE static std::uint32_t leaves_for(std::uint32_t points) {
    std::uint32_t leaves = 2;
    while (leaves * kLeafPoints < points) leaves *= 2;
    return leaves;
  }

  SPLATBUS_PORTABLE void build_leaf(std::uint32_t leaf) const {
    Box box;
    const std::uint32_t first = leaf * kLeafPoints;
    for (std::uint32_t i = first; i < first + kLeafPoints && i < count; ++i) {
      const Vec3 p = load3(points, i);
      box = united(box, {p, p});
    }
    nodes[leaves + leaf] = box;
  }
  SPLATBUS_PORTABLE void build_node(std::uint32_t node) const {
    const std::size_t left = 2 * std::size_t{node};
    nodes[node] = united(nodes[left], nodes[left + 1]);
  }

  /// The nearest points to point i, itself among them.
  template <int kCount>
  [[nodiscard]] SPLATBUS_PORTABLE Nearest<kCount> nearest(std::uint32_t i) const {
    const Vec3 point = load3(points, i);
    Nearest<kCount> found;
    // The leaf beside its own bounds the search well before it begins.
    const std::uint32_t own_leaf = leaves + i / kLeafPoints;
    add_leaf(own_leaf, point, found);
    add_leaf(own_leaf ^ 1U, point, found);
    std::uint32_t waiting[32];  // the tree's depth is below that
    float waiting_distance2[32];
    int depth = 0;
    std::uint32_t node = 1;
    while (true) {
      bool descend = false;
      if (node >= leaves) {
        if ((node ^ own_leaf) > 1) add_leaf(node, point, found);
      } else {
        const Box* const children = nodes + 2 * std::size_t{node};
        const float left = distance2(children[0], point);
        const float right = distance2(children[1], point);
        const bool left_first = left <= right;
        const float near = left_first ? left : right;
        const float far = left_first ? right : left;
        if (far <= found.farthest2() && far < INFINITY) {
          waiting[depth] = 2 * node + (left_first ? 1 : 0);
          waiting_distance2[depth++] = far;
        }
        if (near <= found.farthest2()) {
          node = 2 * node + (left_first ? 0 : 1);
          descend = true;
        }
      }
      while (!descend) {
        if (depth == 0) return found;
        --depth;
        node = waiting[depth];
        descend = waiting_distance2[depth] <= found.farthest2();
      }
    }
  }

 private:
  template <int kCount>
  SPLATBUS_PORTABLE void add_leaf(std::uint32_t node, const Vec3& point, Nearest<kCount>& found) const {
    const std::uint32_t first = (node - leaves) * kLeafPoints;
    for (std::uint32_t i = first; i < first + kLeafPoints && i < count; ++i) {
      const Vec3 offset = load3(points, i) - point;
      found.add(dot(offset, offset), i);
    }
  }
};

/// Neighbours that are looked at: the point itself, and enough to find four on the same side of an edge or a thin
/// sheet.
constexpr int kSearchedNeighbours = 9;

/// What estimate_spacing (stages.h) says of point i. `normal` is [count, 3].
SPLATBUS_PORTABLE float spacing_of(const Nearest<kSearchedNeighbours>& nearest, const float* normal, std::uint32_t i,
                                   float fallback_m) {
  constexpr int kNeighbours = 4;
  constexpr float kSameSurfaceCosine = 0.5F;
  constexpr float kMaxRatio = 4.0F;
  const Vec3 own_normal = load3(normal, i);
  float sum = 0;
  int neighbours = 0;
  for (int k = 0; k < kSearchedNeighbours; ++k) {
    const bool counts = k < nearest.found && neighbours < kNeighbours && nearest.index[k] != i &&
                        !(dot(load3(normal, nearest.index[k]), own_normal) < kSameSurfaceCosine);
    if (!counts) continue;
    sum += sqrtf(nearest.distance2[k]);
    ++neighbours;
  }
  if (neighbours < 2) return fallback_m;
  const float mean = sum / static_cast<float>(neighbours);
  return clamped(mean, fallback_m / kMaxRatio, fallback_m * kMaxRatio);
}

}  // namespace splatbus::capture_bridge
