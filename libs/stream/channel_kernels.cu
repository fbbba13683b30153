#include <thrust/binary_search.h>
#include <thrust/sort.h>

#include <cmath>

#include "device/parallel.h"
#include "gaussians/layout.h"
#include "stream/channel_kernels.h"

namespace splatbus::stream::kernels {
namespace {

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

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t item) const {
    const ColumnBlock block = model.blocks[item];
    const std::size_t offset = model.wide_offset(block.index);
    bool changed = false;
    for (std::uint32_t k = 0; k < block.size; ++k) {
      const std::uint64_t id =
          model.gaussian_id != nullptr ? model.gaussian_id[offset + k] : std::uint64_t{block.index} + k + 1;
      changed |= replace(integers.gaussian_id[block.first + k], id);
    }
    if (changed) raise(&counts->ids);
  }
};

template <std::uint32_t kBlock>
struct MarkUsable {
  ModelChannels model;
  Integers integers;
  ObservedCounts* counts;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t item) const {
    const ColumnBlock block = model.blocks[item];
    const std::size_t offset = model.offset(block.index);
    // What is not finite makes a sum of products with zero no number; unlike a test, that vectorizes.
    float sum[kBlock] = {};
    const auto add = [&](const float* rows, int channels) {
      for (int c = 0; c < channels; ++c) {
        const float* row = rows + static_cast<std::size_t>(c) * model.stride + offset;
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
      object_changed |=
          replace(integers.object_id[i], model.object_id != nullptr ? model.object_id[offset + k] : block.frame_id);
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

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t item) const {
    const ChannelPlan& plan = plans.plan[item / model.block_count];
    const ColumnBlock block = model.blocks[item % model.block_count];
    if (plan.kind == coding::Kind::Rotation) {
      rotation(plan, block);
    } else if (plan.kind == coding::Kind::Normal) {
      normal(plan, block);
    } else {
      const std::size_t offset = model.offset(block.index);
      const float* row = model.parameters + static_cast<std::size_t>(plan.source) * model.stride + offset;
      switch (plan.kind) {
        case coding::Kind::Opacity:
          return map(plan, block, row, [](float x) { return coding::sigmoid(x); });
        case coding::Kind::Albedo:
          return map(plan, block, row, [](float x) { return coding::srgb_odd(x); });
        case coding::Kind::Visibility:
          row = model.visibility != nullptr ? model.visibility + offset : nullptr;
          break;
        default:
          break;
      }
      map(plan, block, row, [](float x) { return x; });
    }
  }

 private:
  template <class Map>
  SPLATBUS_PORTABLE_MEMBER void map(const ChannelPlan& plan, const ColumnBlock& block, const float* row,
                                    Map to_coding_space) const {
    std::int32_t values[kBlock];
    for (std::uint32_t k = 0; k < block.size; ++k) {
      values[k] = plan.step(row != nullptr ? to_coding_space(row[k]) : 1.0F);
    }
    keep(plan, 0, block, values);
  }

  SPLATBUS_PORTABLE_MEMBER void rotation(const ChannelPlan& plan, const ColumnBlock& block) const {
    std::int32_t x[kBlock], y[kBlock], z[kBlock];
    const float* w =
        model.parameters + static_cast<std::size_t>(plan.source) * model.stride + model.offset(block.index);
    for (std::uint32_t k = 0; k < block.size; ++k) {
      const std::uint32_t i = block.first + k;
      coding::Quaternion reference;
      if (held != nullptr && held[i].held != 0) {
        reference = coding::from_rotation_vector({static_cast<float>(held[i].x) * plan.unit,
                                                  static_cast<float>(held[i].y) * plan.unit,
                                                  static_cast<float>(held[i].z) * plan.unit});
      }
      const coding::Quaternion q =
          coding::normalized({w[k], w[model.stride + k], w[2 * model.stride + k], w[3 * model.stride + k]});
      const coding::Vector v = coding::to_rotation_vector(coding::nearest_equivalent(q, reference));
      x[k] = plan.step(v.x);
      y[k] = plan.step(v.y);
      z[k] = plan.step(v.z);
    }
    keep(plan, 0, block, x);
    keep(plan, 1, block, y);
    keep(plan, 2, block, z);
  }

  SPLATBUS_PORTABLE_MEMBER void normal(const ChannelPlan& plan, const ColumnBlock& block) const {
    std::int32_t x[kBlock], y[kBlock];
    const float* n = model.normal != nullptr ? model.normal + model.offset(block.index) : nullptr;
    for (std::uint32_t k = 0; k < block.size; ++k) {
      const coding::Octahedral e = n != nullptr ? coding::octahedral(n[k], n[model.stride + k], n[2 * model.stride + k])
                                                : coding::octahedral(0.0F, 1.0F, 0.0F);
      x[k] = plan.step(e.x);
      y[k] = plan.step(e.y);
    }
    keep(plan, 0, block, x);
    keep(plan, 1, block, y);
  }

  SPLATBUS_PORTABLE_MEMBER void keep(const ChannelPlan& plan, int neighbour, const ColumnBlock& block,
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
  ModelChannels model;
  float* extents;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t item) const {
    const ColumnBlock block = model.blocks[item];
    const float* scales = model.parameters + static_cast<std::size_t>(ParameterLayout::kLogScale) * model.stride +
                          model.offset(block.index);
    for (std::uint32_t k = 0; k < block.size; ++k) {
      const float extent = coding::middle_of(scales[k], scales[model.stride + k], scales[2 * model.stride + k]);
      extents[block.first + k] = math::is_finite(extent) ? extent : INFINITY;
    }
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
struct Scatter {
  const T* values;
  const std::uint32_t* columns;
  T* to;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const { to[columns[i]] = values[i]; }
};

template <std::uint32_t kBlock>
void quantize_in_blocks(const ModelChannels& model, const Plans& plans, const HeldRotation* held,
                        const Integers& integers, const ChangeList& list, device::StreamView stream) {
  device::for_each_index(stream, model.block_count, MarkUsable<kBlock>{model, integers, list.counts});
  device::for_each_index(stream, plans.count * model.block_count, Quantize<kBlock>{model, plans, held, integers, list});
}

}  // namespace

void take_ids(const ModelChannels& model, const Integers& integers, ObservedCounts* counts, device::StreamView stream) {
  device::for_each_index(stream, model.block_count, TakeId{model, integers, counts});
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
  device::for_each_index(stream, model.block_count, Extent{model, extents});
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

void scatter(const std::uint32_t* values, const std::uint32_t* columns, std::uint32_t count, std::uint32_t* to,
             device::StreamView stream) {
  device::for_each_index(stream, count, Scatter<std::uint32_t>{values, columns, to});
}

void scatter(const std::uint8_t* values, const std::uint32_t* columns, std::uint32_t count, std::uint8_t* to,
             device::StreamView stream) {
  device::for_each_index(stream, count, Scatter<std::uint8_t>{values, columns, to});
}

}  // namespace splatbus::stream::kernels
