#include <thrust/copy.h>
#include <thrust/iterator/counting_iterator.h>
#include <thrust/sequence.h>
#include <thrust/sort.h>

#include "expander/cell_search.h"

namespace splatbus::expander {

using device::Buffer;
using device::for_each_index;
using device::StreamView;
using device::with_policy;
using math::Vec3;

namespace {

constexpr std::uint32_t kNeighbours = 27;

struct IsSet {
  SPLATBUS_PORTABLE_MEMBER bool operator()(std::uint8_t flag) const { return flag != 0; }
};

SPLATBUS_PORTABLE bool finite(const Vec3& v) {
  return math::is_finite(v.x) && math::is_finite(v.y) && math::is_finite(v.z);
}

struct ValidateSample {
  Samples samples;
  std::uint32_t* invalid;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const Vec3 normal = samples.normal[i], albedo = samples.albedo[i], color = samples.color[i];
    const float spacing_m = samples.spacing_m[i];
    const bool valid = finite(samples.position[i]) && finite(normal) && finite(albedo) && finite(color) &&
                       fabsf(length(normal) - 1) < kUnitTolerance && spacing_m > 0 && spacing_m < kMaxSpacing_m;
    if (!valid) {
      samples.spacing_m[i] = 0;
      device::atomic_add(invalid, 1U);
      return;
    }
    samples.normal[i] = normalized(normal);
    samples.albedo[i] = {math::clamped(albedo.x, 0, 1), math::clamped(albedo.y, 0, 1), math::clamped(albedo.z, 0, 1)};
    samples.color[i] = {math::larger(color.x, 0), math::larger(color.y, 0), math::larger(color.z, 0)};
  }
};

/// A sample in the frame that its Gaussian is to live in, and in that frame's lengths.
struct LocalSample {
  CellKey cell;
  Vec3 position, normal;
  float spacing;
};

struct Frames {
  const ObjectFrame* objects;
  std::uint32_t count;
  float cell_size_m;

  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER LocalSample localised(const Samples& samples, std::uint32_t i) const {
    LocalSample local{{}, samples.position[i], samples.normal[i], samples.spacing_m[i]};
    std::uint32_t frame_id = kWorldFrame;
    const std::uint32_t id = samples.object_id[i];
    std::uint32_t first = 0, end = count;
    while (first < end) {
      const std::uint32_t middle = first + (end - first) / 2;
      if (objects[middle].id < id) {
        first = middle + 1;
      } else {
        end = middle;
      }
    }
    if (first < count && objects[first].id == id) {
      frame_id = id;
      const math::Similarity& object_from_world = objects[first].object_from_world;
      local.position = transformed(object_from_world, local.position);
      local.normal = object_from_world.rotation * local.normal;
      local.spacing *= object_from_world.scale;
    }
    local.cell = cell_at(local.position, frame_id, cell_size_m);
    return local;
  }
};

struct BinSample {
  Samples samples;
  Frames frames;
  Vec3 viewer;
  float radius_m;
  CellKey* keys;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const bool candidate = samples.spacing_m[i] > 0 && !(length(samples.position[i] - viewer) > radius_m);
    keys[i] = candidate ? frames.localised(samples, i).cell : CellKey{};
  }
};

struct Cells {
  const CellKey* keys;         ///< ascending
  const std::uint32_t* start;  ///< [count + 1], of their samples
  std::uint32_t count;

  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER std::uint32_t samples(std::uint32_t cell) const {
    return start[cell + 1] - start[cell];
  }
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER std::uint32_t samples(const CellKey& key) const {
    const std::uint32_t cell = lower_bound(keys, count, key);
    return cell < count && keys[cell] == key ? samples(cell) : 0;
  }
};

/// Offset of neighbour 0 to 26 along an axis.
SPLATBUS_PORTABLE int offset_of(std::uint32_t neighbour_index, std::uint32_t divisor) {
  return static_cast<int>(neighbour_index / divisor % 3) - 1;
}
SPLATBUS_PORTABLE CellKey neighbour_of(const CellKey& key, std::uint32_t k) {
  return neighbour(key, offset_of(k, 9), offset_of(k, 3), offset_of(k, 1));
}

/// For each cell of the round whether it is seen, and where the points of its neighbours lie.
struct TestCell {
  Cells cells;
  const CellKey* modelled;
  std::uint32_t modelled_count;
  std::uint32_t min_samples;
  float new_distance, top_up_distance;
  float* distance;            ///< to what is modelled, of the spacing; negative: not seen
  std::uint32_t* neighbours;  ///< [cells][27][2]: first modelled point, one behind the last

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t cell) const {
    const CellKey key = cells.keys[cell];
    // A surface that only cuts a cell's corner leaves few samples there; what lies alone is no surface.
    bool seen = cells.samples(cell) >= min_samples;
    for (std::uint32_t k = 0; k < kNeighbours; ++k) {
      const CellKey at = neighbour_of(key, k);
      std::uint32_t* const range = neighbours + 2 * (std::size_t{cell} * kNeighbours + k);
      range[0] = range[1] = 0;
      if (at.none()) continue;
      seen = seen || cells.samples(at) >= min_samples;
      range[0] = lower_bound(modelled, modelled_count, at);
      range[1] =
          range[0] + lower_bound(modelled + range[0], modelled_count - range[0], CellKey{at.object_id, at.cell + 1});
    }
    const std::uint32_t* const own = neighbours + 2 * (std::size_t{cell} * kNeighbours + kNeighbours / 2);
    distance[cell] = seen ? (own[0] == own[1] ? new_distance : top_up_distance) : -1.0F;
  }
};

/// For each sample, in the order of the cells, whether nothing modelled covers it.
struct TestSample {
  Samples samples;
  Frames frames;
  Cells cells;
  const CellKey* keys;
  const std::uint32_t* order;
  const ModelledPoint* points;
  const float* distance;
  const std::uint32_t* neighbours;
  std::uint8_t* uncovered;
  std::uint32_t* new_samples;  ///< [cells]

  /// True when something modelled within `distance`, at most the cell size, faces the same way.
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER bool covered(std::uint32_t cell, const LocalSample& local,
                                                      float distance) const {
    // Which neighbours the sphere about the position reaches into.
    const Vec3 within = local.position - cell_centre(local.cell, frames.cell_size_m);
    const float inner = 0.5F * frames.cell_size_m - distance;
    const auto reaches = [&](float along, int side) {
      return side == 0 || (side < 0 ? along < -inner : along > inner);
    };
    for (std::uint32_t k = 0; k < kNeighbours; ++k) {
      if (!reaches(within.x, offset_of(k, 9)) || !reaches(within.y, offset_of(k, 3)) ||
          !reaches(within.z, offset_of(k, 1))) {
        continue;
      }
      const std::uint32_t* const range = neighbours + 2 * (std::size_t{cell} * kNeighbours + k);
      for (std::uint32_t p = range[0]; p < range[1]; ++p) {
        const Vec3 apart = points[p].position - local.position;
        if (dot(apart, apart) < distance * distance && dot(points[p].normal, local.normal) > kSameSurfaceCosine) {
          return true;
        }
      }
    }
    return false;
  }

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const std::uint32_t cell = lower_bound(cells.keys, cells.count, keys[i]);
    const std::uint32_t sample = order[i];
    uncovered[i] = 0;
    if (distance[cell] < 0) return;
    const LocalSample local = frames.localised(samples, sample);
    if (covered(cell, local, math::smaller(distance[cell] * local.spacing, frames.cell_size_m))) return;
    uncovered[i] = 1;
    device::atomic_add(new_samples + cell, 1U);
  }
};

/// A cell that lacks too little of what it holds already is left alone.
struct WantSample {
  Cells cells;
  const CellKey* keys;
  const std::uint32_t* order;
  const std::uint32_t* neighbours;
  const std::uint8_t* uncovered;
  const std::uint32_t* new_samples;
  float top_up_fraction;
  std::uint8_t* wanted;  ///< [samples of the round], in its order

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const std::uint32_t cell = lower_bound(cells.keys, cells.count, keys[i]);
    const std::uint32_t* const own = neighbours + 2 * (std::size_t{cell} * kNeighbours + kNeighbours / 2);
    const float worth = ceilf(top_up_fraction * static_cast<float>(own[1] - own[0]));
    wanted[order[i]] = uncovered[i] != 0 && static_cast<float>(new_samples[cell]) >= worth ? 1 : 0;
  }
};

struct WriteGaussian {
  Samples samples;
  Frames frames;
  const std::uint32_t* selected;
  float scale, log_flatness, opacity_logit;
  LightTerms light;
  InsertChannels out;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const std::size_t n = out.count;
    const std::uint32_t s = selected[i];
    const LocalSample local = frames.localised(samples, s);
    const float along = logf(math::larger(local.spacing, kMinSpacing_m) * scale);
    const math::Vec4 rotation = rotation_to_normal(local.normal);
    put(out.mean, n, i, local.position);
    put(out.log_scale, n, i, {along, along, along + log_flatness});
    put(out.rotation, n, i, rotation.xyz);
    out.rotation[3 * n + i] = rotation.w;
    out.opacity_logit[i] = opacity_logit;
    put(out.albedo, n, i, samples.albedo[s]);
    put(out.normal, n, i, local.normal);
    out.visibility[i] = guess_visibility(samples.color[s], samples.albedo[s], samples.normal[s], light);
    out.object_id[i] = local.cell.object_id;
  }
};

}  // namespace

Samples samples_at(std::byte* memory, std::uint32_t count) {
  auto* const position = reinterpret_cast<Vec3*>(memory);
  auto* const spacing_m = reinterpret_cast<float*>(position + std::size_t{4} * count);
  return {position,
          position + count,
          position + std::size_t{2} * count,
          position + std::size_t{3} * count,
          spacing_m,
          reinterpret_cast<std::uint32_t*>(spacing_m + count),
          count};
}

std::uint32_t validate(StreamView stream, const Samples& samples) {
  Buffer<std::uint32_t> invalid(stream, 1);
  invalid.clear();
  for_each_index(stream, samples.count, ValidateSample{samples, invalid.data()});
  return invalid.to_host().front();
}

SampleSelector::SampleSelector(StreamView stream)
    : stream_(stream),
      objects_(stream),
      keys_(stream),
      cell_keys_(stream),
      order_(stream),
      cell_start_(stream),
      new_samples_(stream),
      selected_(stream),
      uncovered_(stream),
      wanted_(stream),
      distance_(stream),
      neighbours_(stream) {}

std::uint32_t SampleSelector::bin(const Samples& samples, std::span<const ObjectFrame> objects,
                                  const SelectOptions& options) {
  const std::uint32_t n = samples.count;
  objects_.assign(objects);
  for (auto* buffer : {&keys_, &cell_keys_}) reserve(*buffer, n);
  for (auto* buffer : {&order_, &selected_}) reserve(*buffer, n);
  for (auto* buffer : {&uncovered_, &wanted_}) reserve(*buffer, n);
  reserve(cell_start_, std::size_t{n} + 1);
  const Frames frames{objects_.data(), static_cast<std::uint32_t>(objects_.size()), cell_size_m_};
  for_each_index(stream_, n, BinSample{samples, frames, options.viewer, options.candidate_radius_m, keys_.data()});
  with_policy(stream_, [&](auto&& policy) {
    thrust::sequence(policy, order_.data(), order_.data() + n);
    thrust::sort_by_key(policy, keys_.data(), keys_.data() + n, order_.data(), KeyBelow());
  });
  binned_ = named_count(stream_, keys_.data(), n);
  cells_ = list_cells(stream_, keys_.data(), binned_, cell_keys_.data(), cell_start_.data());
  device::copy(stream_, cell_start_.data() + cells_, &binned_, sizeof(binned_));
  return cells_;
}

std::uint32_t SampleSelector::select(const Samples& samples, std::span<const ObjectFrame> objects,
                                     const PointGrid& modelled, const SelectOptions& options) {
  cell_size_m_ = modelled.cell_size_m();
  binned_ = cells_ = 0;
  if (samples.count == 0 || bin(samples, objects, options) == 0) return 0;
  reserve(distance_, cells_);
  reserve(new_samples_, cells_);
  reserve(neighbours_, std::size_t{2} * kNeighbours * cells_);
  new_samples_.clear();
  device::fill(stream_, wanted_.data(), 0, samples.count);
  const Frames frames{objects_.data(), static_cast<std::uint32_t>(objects_.size()), cell_size_m_};
  const Cells cells{cell_keys_.data(), cell_start_.data(), cells_};
  for_each_index(stream_, cells_,
                 TestCell{cells, modelled.keys(), modelled.size(), options.min_samples, options.new_distance,
                          options.top_up_distance, distance_.data(), neighbours_.data()});
  for_each_index(stream_, binned_,
                 TestSample{samples, frames, cells, keys_.data(), order_.data(), modelled.points(), distance_.data(),
                            neighbours_.data(), uncovered_.data(), new_samples_.data()});
  for_each_index(stream_, binned_,
                 WantSample{cells, keys_.data(), order_.data(), neighbours_.data(), uncovered_.data(),
                            new_samples_.data(), options.top_up_fraction, wanted_.data()});
  return with_policy(stream_, [&](auto&& policy) {
    const auto first = thrust::make_counting_iterator(std::uint32_t{0});
    std::uint32_t* const end =
        thrust::copy_if(policy, first, first + samples.count, wanted_.data(), selected_.data(), IsSet());
    return std::min(static_cast<std::uint32_t>(end - selected_.data()), options.room);
  });
}

void SampleSelector::write(const Samples& samples, std::uint32_t first, const InitialOptions& options,
                           const LightTerms& light, const InsertChannels& gaussians) const {
  const Frames frames{objects_.data(), static_cast<std::uint32_t>(objects_.size()), cell_size_m_};
  for_each_index(stream_, gaussians.count,
                 WriteGaussian{samples, frames, selected_.data() + first, options.scale, std::log(options.flatness),
                               std::log(options.opacity / (1 - options.opacity)), light, gaussians});
}

std::vector<CellCount> SampleSelector::cells() const {
  return counts_of(stream_, cell_keys_.data(), cell_start_.data(), cells_, binned_);
}

}  // namespace splatbus::expander
