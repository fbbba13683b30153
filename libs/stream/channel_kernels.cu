#include <thrust/binary_search.h>
#include <thrust/sort.h>

#include <cmath>

#include "device/parallel.h"
#include "gaussians/layout.h"
#include "stream/channel_kernels.h"

namespace splatbus::stream::kernels {
namespace {

// Columns that one thread takes: of a GPU's threads each one, of a CPU's a block whose channels stay in its cache.
constexpr std::uint32_t kDeviceBlock = 1, kHostBlock = 512;

template <class T>
SPLATBUS_PORTABLE bool replace(T& kept, T value) {
  const bool changed = kept != value;
  kept = value;
  return changed;
}

SPLATBUS_PORTABLE void raise(std::uint32_t* flag) {
#ifdef __CUDA_ARCH__
  *flag = 1;
#else
  if (__atomic_load_n(flag, __ATOMIC_RELAXED) == 0) __atomic_store_n(flag, 1U, __ATOMIC_RELAXED);
#endif
}

struct TakeId {
  ModelChannels model;
  Integers integers;
  ObservedCounts* counts;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const std::uint64_t id = model.gaussian_id != nullptr ? model.gaussian_id[i] : std::uint64_t{i} + 1;
    if (replace(integers.gaussian_id[i], id)) raise(&counts->ids);
  }
};

/// Columns [first, first + size) of the item.
template <std::uint32_t kBlock>
struct Block {
  std::uint32_t first, size;

  SPLATBUS_PORTABLE_MEMBER Block(std::uint32_t block, std::uint32_t count) : first(block * kBlock), size(kBlock) {
    if (size > count - first) size = count - first;
  }
};

template <std::uint32_t kBlock>
struct MarkUsable {
  ModelChannels model;
  Integers integers;
  ObservedCounts* counts;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t item) const {
    const Block<kBlock> block(item, model.count);
    // What is not finite makes a sum of products with zero no number; unlike a test, that vectorizes.
    float sum[kBlock] = {};
    const auto add = [&](const float* rows, int channels) {
      for (int c = 0; c < channels; ++c) {
        const float* row = rows + static_cast<std::size_t>(c) * model.stride + block.first;
        for (std::uint32_t k = 0; k < block.size; ++k) sum[k] += 0.0F * row[k];
      }
    };
    add(model.parameters, model.channels);
    if (model.normal != nullptr) add(model.normal, 3);
    if (model.visibility != nullptr) add(model.visibility, 1);
    bool usable_changed = false, object_changed = false;
    for (std::uint32_t k = 0; k < block.size; ++k) {
      const std::uint32_t i = block.first + k;
      usable_changed |= replace(integers.usable[i], static_cast<std::uint8_t>(sum[k] == 0.0F ? 1 : 0));
      object_changed |= replace(integers.object_id[i], model.object_id != nullptr ? model.object_id[i] : 0U);
    }
    if (usable_changed) raise(&counts->usable);
    if (object_changed) raise(&counts->object_ids);
  }
};

/// An item is a block of columns of one plan.
template <std::uint32_t kBlock>
struct Quantize {
  ModelChannels model;
  Plans plans;
  const HeldRotation* held;
  Integers integers;
  ChangeList list;
  std::uint32_t blocks;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t item) const {
    const ChannelPlan& plan = plans.plan[item / blocks];
    const Block<kBlock> block(item % blocks, model.count);
    if (plan.kind == coding::Kind::Rotation) {
      rotation(plan, block);
    } else if (plan.kind == coding::Kind::Normal) {
      normal(plan, block);
    } else {
      const float* row = model.parameters + static_cast<std::size_t>(plan.source) * model.stride;
      switch (plan.kind) {
        case coding::Kind::Opacity:
          return map(plan, block, row, [](float x) { return coding::sigmoid(x); });
        case coding::Kind::Albedo:
          return map(plan, block, row, [](float x) { return coding::srgb_odd(x); });
        case coding::Kind::Visibility:
          row = model.visibility;
          break;
        default:
          break;
      }
      map(plan, block, row, [](float x) { return x; });
    }
  }

 private:
  template <class Map>
  SPLATBUS_PORTABLE_MEMBER void map(const ChannelPlan& plan, const Block<kBlock>& block, const float* row,
                                    Map to_coding_space) const {
    std::int32_t values[kBlock];
    for (std::uint32_t k = 0; k < block.size; ++k) {
      values[k] = plan.step(row != nullptr ? to_coding_space(row[block.first + k]) : 1.0F);
    }
    keep(plan, 0, block, values);
  }

  SPLATBUS_PORTABLE_MEMBER void rotation(const ChannelPlan& plan, const Block<kBlock>& block) const {
    std::int32_t x[kBlock], y[kBlock], z[kBlock];
    const float* w = model.parameters + static_cast<std::size_t>(plan.source) * model.stride;
    for (std::uint32_t k = 0; k < block.size; ++k) {
      const std::uint32_t i = block.first + k;
      coding::Quaternion reference;
      if (held != nullptr && held[i].held != 0) {
        reference = coding::from_rotation_vector({static_cast<float>(held[i].x) * plan.unit,
                                                  static_cast<float>(held[i].y) * plan.unit,
                                                  static_cast<float>(held[i].z) * plan.unit});
      }
      const coding::Quaternion q =
          coding::normalized({w[i], w[model.stride + i], w[2 * model.stride + i], w[3 * model.stride + i]});
      const coding::Vector v = coding::to_rotation_vector(coding::nearest_equivalent(q, reference));
      x[k] = plan.step(v.x);
      y[k] = plan.step(v.y);
      z[k] = plan.step(v.z);
    }
    keep(plan, 0, block, x);
    keep(plan, 1, block, y);
    keep(plan, 2, block, z);
  }

  SPLATBUS_PORTABLE_MEMBER void normal(const ChannelPlan& plan, const Block<kBlock>& block) const {
    std::int32_t x[kBlock], y[kBlock];
    const float* n = model.normal;
    for (std::uint32_t k = 0; k < block.size; ++k) {
      const std::uint32_t i = block.first + k;
      const coding::Octahedral e = n != nullptr ? coding::octahedral(n[i], n[model.stride + i], n[2 * model.stride + i])
                                                : coding::octahedral(0.0F, 1.0F, 0.0F);
      x[k] = plan.step(e.x);
      y[k] = plan.step(e.y);
    }
    keep(plan, 0, block, x);
    keep(plan, 1, block, y);
  }

  SPLATBUS_PORTABLE_MEMBER void keep(const ChannelPlan& plan, int neighbour, const Block<kBlock>& block,
                                     const std::int32_t* values) const {
    const std::size_t row = static_cast<std::size_t>(plan.storage + neighbour) * model.count + block.first;
    std::uint32_t changed[kBlock], changes = 0;
    for (std::uint32_t k = 0; k < block.size; ++k) {
      const std::int32_t value = integers.usable[block.first + k] != 0 ? values[k] : 0;
      const bool is_new = plan.is_wide ? replace(integers.wide[row + k], value)
                                       : replace(integers.narrow[row + k], static_cast<std::int16_t>(value));
      changed[changes] = k;
      changes += is_new ? 1 : 0;
    }
    if (changes == 0 || list.capacity == 0) return;
    const std::uint32_t channel = static_cast<std::uint32_t>(plan.first + neighbour) << kChannelShift;
    const std::uint32_t base = device::atomic_add(&list.counts->values, changes);
    for (std::uint32_t c = 0; c < changes && base + c < list.capacity; ++c) {
      const std::uint32_t k = changed[c];
      const std::int32_t value = integers.usable[block.first + k] != 0 ? values[k] : 0;
      list.changes[base + c] = {channel | (block.first + k), value};
    }
  }
};

struct Extent {
  const float* scales;  ///< [3][stride]
  std::size_t stride;
  float* extents;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const float extent = coding::middle_of(scales[i], scales[stride + i], scales[2 * stride + i]);
    extents[i] = math::is_finite(extent) ? extent : INFINITY;
  }
};

struct Dequantize {
  DisplayPlan plan;
  const std::int32_t* values;
  const std::uint32_t* columns;
  std::uint32_t count;
  float* rows;
  std::size_t stride;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    float* to = rows + static_cast<std::size_t>(plan.row) * stride + columns[i];
    if (plan.kind == coding::Kind::Rotation) {
      const coding::Quaternion q = coding::from_rotation_vector({value(0, i), value(1, i), value(2, i)});
      to[0] = q.w;
      to[stride] = q.x;
      to[2 * stride] = q.y;
      to[3 * stride] = q.z;
    } else if (plan.kind == coding::Kind::Normal) {
      const coding::Vector n = coding::from_octahedral({value(0, i), value(1, i)});
      to[0] = n.x;
      to[stride] = n.y;
      to[2 * stride] = n.z;
    } else {
      for (int c = 0; c < plan.channels; ++c) to[static_cast<std::size_t>(c) * stride] = decoded(value(c, i));
    }
  }

 private:
  SPLATBUS_PORTABLE_MEMBER float value(int channel, std::uint32_t i) const {
    return plan.offset + plan.step * static_cast<float>(values[static_cast<std::size_t>(channel) * count + i]);
  }
  SPLATBUS_PORTABLE_MEMBER float decoded(float x) const {
    if (plan.kind == coding::Kind::Opacity) return coding::logit(x);
    return plan.kind == coding::Kind::Albedo ? coding::linear_odd(x) : x;
  }
};

template <class T>
struct Gather {
  const T* from;
  const std::uint32_t* order;
  T* to;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const { to[i] = from[order[i]]; }
};

struct Scatter {
  const std::uint32_t *values, *columns;
  std::uint32_t* to;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const { to[columns[i]] = values[i]; }
};

template <std::uint32_t kBlock>
void quantize_in_blocks(const ModelChannels& model, const Plans& plans, const HeldRotation* held,
                        const Integers& integers, const ChangeList& list, device::StreamView stream) {
  const std::uint32_t blocks = (model.count + kBlock - 1) / kBlock;
  device::for_each_index(stream, blocks, MarkUsable<kBlock>{model, integers, list.counts});
  device::for_each_index(stream, plans.count * blocks, Quantize<kBlock>{model, plans, held, integers, list, blocks});
}

}  // namespace

void take_ids(const ModelChannels& model, const Integers& integers, ObservedCounts* counts, device::StreamView stream) {
  device::for_each_index(stream, model.count, TakeId{model, integers, counts});
}

void quantize(const ModelChannels& model, const Plans& plans, const HeldRotation* held, const Integers& integers,
              const ChangeList& list, device::StreamView stream) {
  if (stream.on_cuda()) {
    quantize_in_blocks<kDeviceBlock>(model, plans, held, integers, list, stream);
  } else {
    quantize_in_blocks<kHostBlock>(model, plans, held, integers, list, stream);
  }
}

std::uint32_t sort_extents(const ModelChannels& model, float* extents, device::StreamView stream) {
  if (model.count == 0) return 0;
  const float* scales = model.parameters + static_cast<std::size_t>(ParameterLayout::kLogScale) * model.stride;
  device::for_each_index(stream, model.count, Extent{scales, model.stride, extents});
  float* const end = extents + model.count;
  return device::with_policy(stream, [&](auto&& policy) {
    thrust::sort(policy, extents, end);
    return static_cast<std::uint32_t>(thrust::lower_bound(policy, extents, end, INFINITY) - extents);
  });
}

void dequantize(const DisplayPlan& plan, const std::int32_t* values, const std::uint32_t* columns, std::uint32_t count,
                float* rows, std::size_t stride, device::StreamView stream) {
  device::for_each_index(stream, count, Dequantize{plan, values, columns, count, rows, stride});
}

void gather(const float* from, const std::uint32_t* order, std::uint32_t count, float* to, device::StreamView stream) {
  device::for_each_index(stream, count, Gather<float>{from, order, to});
}

void gather(const std::uint32_t* from, const std::uint32_t* order, std::uint32_t count, std::uint32_t* to,
            device::StreamView stream) {
  device::for_each_index(stream, count, Gather<std::uint32_t>{from, order, to});
}

void scatter(const std::uint32_t* values, const std::uint32_t* columns, std::uint32_t count, std::uint32_t* to,
             device::StreamView stream) {
  device::for_each_index(stream, count, Scatter{values, columns, to});
}

}  // namespace splatbus::stream::kernels
