// What is done to Gaussians in the lanes where they lie.

#include <algorithm>

#include "device/parallel.h"
#include "model/page_kernels.h"

namespace splatbus::model {

namespace {

using device::for_each_index;

constexpr float kPi = 3.14159265358979323846F;
constexpr float kShC0 = 0.28209479177387814F;  // signs and constants as in gaussians/sh.h
constexpr float kShC1 = 0.4886025119029199F;
constexpr float kShC2[3] = {1.0925484305920792F, 0.31539156525252005F, 0.5462742152960396F};

struct LightRow {
  InsertRows rows;
  std::uint32_t count;
  InsertLight light;
  const ObjectRotation* objects;
  std::uint32_t object_count;
  float* dc;

  /// Null for what stands still.
  SPLATBUS_PORTABLE_MEMBER const ObjectRotation* object_of(std::uint32_t k) const {
    for (std::uint32_t low = 0, high = object_count; low < high;) {
      const std::uint32_t middle = (low + high) / 2;
      const ObjectRotation& q = objects[middle];
      if (q.id == rows.object_id[k]) return &q;
      (q.id < rows.object_id[k] ? low : high) = q.id < rows.object_id[k] ? middle + 1 : middle;
    }
    return nullptr;
  }
  /// ambient_reflected() of gaussians/light.h.
  SPLATBUS_PORTABLE_MEMBER float ambient_reflected(int color, const math::Vec3& n) const {
    const float basis[9] = {kShC0,
                            -2.0F / 3 * kShC1 * n.y,
                            2.0F / 3 * kShC1 * n.z,
                            -2.0F / 3 * kShC1 * n.x,
                            0.25F * kShC2[0] * n.x * n.y,
                            0.25F * -kShC2[0] * n.y * n.z,
                            0.25F * kShC2[1] * (2 * n.z * n.z - n.x * n.x - n.y * n.y),
                            0.25F * -kShC2[0] * n.x * n.z,
                            0.25F * kShC2[2] * (n.x * n.x - n.y * n.y)};
    float sum = 0;
    for (int k = 0; k < 9; ++k) sum += basis[k] * light.ambient_sh[3 * k + color];
    return sum;
  }
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t k) const {
    const ObjectRotation* const object = object_of(k);
    math::Vec3 n{rows.normal[k], rows.normal[rows.stride + k], rows.normal[2 * rows.stride + k]};
    if (object != nullptr) n = math::rotation_matrix(object->w, object->x, object->y, object->z) * n;
    const bool shines = object != nullptr && object->emissive;
    const math::Vec3 sun{light.sun_direction[0], light.sun_direction[1], light.sun_direction[2]};
    const float cosine = math::larger(0.0F, math::dot(n, sun));
    for (int c = 0; c < 3; ++c) {
      const float direct = light.sun_irradiance[c] * (rows.visibility[k] * cosine / kPi);
      const float light_c = shines ? 1.0F : math::larger(ambient_reflected(c, n), 0.0F) + direct;
      const float lit = rows.albedo[c * rows.stride + k] * light_c;
      dc[std::size_t{count} * c + k] = (math::srgb_from_linear(lit) - 0.5F) / kShC0;
    }
  }
};

/// Where a page's rows of floats come from; null: 0.
struct RowSources {
  const float* plane[kMaxPageRows];
};

/// What writes and copies channels does a Gaussian and this many rows at a time: neighbours do neighbouring lanes, and
/// a division pays for several words.
constexpr std::uint32_t kRowsAtOnce = 4;

std::uint32_t items_for(std::uint32_t count, std::uint32_t rows) {
  return count * ((rows + kRowsAtOnce - 1) / kRowsAtOnce);
}

struct WriteRow {
  PageMemory memory;
  RowSources sources;
  const Item* items;
  std::uint32_t count, float_rows;
  const std::uint32_t* to;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const std::uint32_t chunk = i / count, k = items[i - chunk * count].source, index = to[k];
    if (index == kNotInserted) return;
    const std::uint32_t end = (chunk + 1) * kRowsAtOnce < float_rows ? (chunk + 1) * kRowsAtOnce : float_rows;
    for (std::uint32_t row = chunk * kRowsAtOnce; row < end; ++row) {
      *memory.value(row, index) = sources.plane[row] == nullptr ? 0.0F : sources.plane[row][k];
    }
  }
};

struct Number {
  PageMemory memory;
  const std::uint32_t* to;
  std::uint64_t first_id;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t k) const {
    if (to[k] != kNotInserted) *memory.wide(memory.gaussian_id, to[k]) = first_id + k;
  }
};

struct CopyRows {
  PageMemory memory;
  const std::uint32_t *from, *to;
  std::uint32_t count, float_rows;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const std::uint32_t chunk = i / count, k = i - chunk * count, source = from[k], index = to[k];
    if (index == kNotInserted) return;
    const std::uint32_t end = (chunk + 1) * kRowsAtOnce < float_rows ? (chunk + 1) * kRowsAtOnce : float_rows;
    for (std::uint32_t row = chunk * kRowsAtOnce; row < end; ++row) {
      *memory.word(row, index) = *memory.word(row, source);
    }
  }
};

struct CopyId {
  PageMemory memory;
  const std::uint32_t *from, *to;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t k) const {
    *memory.wide(memory.gaussian_id, to[k]) = *memory.wide(memory.gaussian_id, from[k]);
  }
};

struct CountDead {
  const std::uint8_t* dead;
  const LaneRange* pages;
  PageRemoval* removals;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t p) const {
    const LaneRange page = pages[p];
    PageRemoval removal;
    for (std::uint32_t k = 0; k < page.count; ++k) removal.dead += dead[page.first + k] != 0 ? 1U : 0U;
    for (std::uint32_t k = 0; k + removal.dead < page.count; ++k) {
      removal.holes += dead[page.first + k] != 0 ? 1U : 0U;
    }
    removals[p] = removal;
  }
};

struct ClearDeadIds {
  PageMemory memory;
  const std::uint8_t* dead;
  const LaneRange* pages;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const LaneRange page = pages[i / kPageLanes];
    const std::uint32_t lane = i % kPageLanes;
    if (lane < page.count && dead[page.first + lane] != 0) *memory.wide(memory.gaussian_id, page.first + lane) = 0;
  }
};

struct ListMoves {
  const std::uint8_t* dead;
  const LaneRange* pages;
  const std::uint32_t* first_move;
  std::uint32_t *from, *to;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t p) const {
    const LaneRange page = pages[p];
    std::uint32_t hole = page.first, end = page.first + page.count;
    for (std::uint32_t move = first_move[p];; ++move) {
      while (hole < end && dead[hole] == 0) ++hole;
      while (end > hole && dead[end - 1] != 0) --end;
      if (hole >= end) return;
      from[move] = --end;
      to[move] = hole++;
    }
  }
};

struct BoundLanes {
  PageMemory memory;
  const LaneRange* lanes;
  PageBounds* bounds;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t r) const {
    PageBounds result;
    float max_log_scale = -INFINITY;
    const LaneRange range = lanes[r];
    const float* const first = memory.value(0, range.first);
    for (std::uint32_t k = 0; k < range.count; ++k) {
      const auto at = [&](int channel) { return first[std::size_t{kRowWords} * channel + k]; };
      const math::Vec3 mean{at(ParameterLayout::kMean), at(ParameterLayout::kMean + 1), at(ParameterLayout::kMean + 2)};
      if (!include(result, mean)) continue;
      for (int c = 0; c < 3; ++c) max_log_scale = math::larger(at(ParameterLayout::kLogScale + c), max_log_scale);
    }
    result.max_scale_m = expf(max_log_scale);
    bounds[r] = result;
  }
};

struct WriteVisibility {
  PageMemory memory;
  const std::uint8_t* values;
  const LaneRange* pages;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const LaneRange page = pages[i / kPageLanes];
    const std::uint32_t lane = i % kPageLanes, index = page.first + lane;
    if (lane >= page.count) return;
    *memory.value(memory.visibility, index) = (1.0F / 255) * static_cast<float>(values[index]);
  }
};

struct TakeAverage {
  PageMemory memory;
  const LaneRange* pages;
  std::uint32_t channels;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const LaneRange page = pages[i / kPageLanes];
    const std::uint32_t lane = i % kPageLanes, index = page.first + lane;
    if (lane >= page.count) return;
    for (std::uint32_t c = 0; c < channels; ++c) *memory.value(c, index) = *memory.value(channels + c, index);
  }
};

struct MarkBroken {
  PageMemory memory;
  const LaneRange* pages;
  std::uint8_t* dead;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const LaneRange page = pages[i / kPageLanes];
    const std::uint32_t lane = i % kPageLanes, index = page.first + lane;
    if (lane >= page.count) return;
    bool whole = *memory.wide(memory.gaussian_id, index) != 0;
    for (std::uint32_t row = 0; row < memory.gaussian_id; ++row) {
      whole = whole && math::is_finite(*memory.value(row, index));
    }
    if (!whole) dead[index] = 1;
  }
};

/// run(pages) for some at a time, so that an item's number fits.
template <class Run>
void by_lane(StreamView stream, std::span<const LaneRange> pages, Run&& run) {
  constexpr std::size_t kAtOnce = (std::size_t{1} << 31U) / kPageLanes;
  for (std::size_t first = 0; first < pages.size(); first += kAtOnce) {
    const auto some = pages.subspan(first, std::min(kAtOnce, pages.size() - first));
    const Buffer<LaneRange> on_device = uploaded(stream, some);
    for_each_index(stream, static_cast<std::uint32_t>(some.size()) * kPageLanes, run(on_device.data()));
    stream.wait();
  }
}

}  // namespace

void light_rows(StreamView stream, const InsertRows& rows, std::uint32_t count, const InsertLight& light,
                std::span<const ObjectRotation> objects, float* dc) {
  const Buffer<ObjectRotation> on_device = uploaded(stream, objects);
  for_each_index(stream, count,
                 LightRow{rows, count, light, on_device.data(), static_cast<std::uint32_t>(objects.size()), dc});
  stream.wait();
}

void write_rows(StreamView stream, const PageMemory& memory, const ParameterLayout& layout, const InsertRows& rows,
                const float* appearance, std::size_t appearance_stride, const Item* items, std::uint32_t count,
                const std::uint32_t* to) {
  RowSources sources{};
  const auto from = [&](std::uint32_t row, const float* planes, std::size_t stride, int channels) {
    for (int c = 0; c < channels; ++c) sources.plane[row + static_cast<std::uint32_t>(c)] = planes + stride * c;
  };
  for (const Channel channel : {Channel::Parameters, Channel::Average}) {
    const std::uint32_t first = rows_of(channel, layout).first;
    from(first + ParameterLayout::kMean, rows.mean, rows.stride, 3);
    from(first + ParameterLayout::kLogScale, rows.log_scale, rows.stride, 3);
    from(first + ParameterLayout::kRotation, rows.rotation, rows.stride, 4);
    from(first + ParameterLayout::kOpacityLogit, rows.opacity_logit, rows.stride, 1);
    from(first + ParameterLayout::kAppearance, appearance, appearance_stride, 3);
  }
  from(memory.normal, rows.normal, rows.stride, 3);
  from(memory.surface_point, rows.mean, rows.stride, 3);
  from(memory.visibility, rows.visibility, rows.stride, 1);
  const std::uint32_t float_rows = memory.gaussian_id;
  for_each_index(stream, items_for(count, float_rows), WriteRow{memory, sources, items, count, float_rows, to});
}

void number(StreamView stream, const PageMemory& memory, const std::uint32_t* to, std::uint32_t count,
            std::uint64_t first_id) {
  for_each_index(stream, count, Number{memory, to, first_id});
}

void copy_lanes(StreamView stream, const PageMemory& memory, const std::uint32_t* from, const std::uint32_t* to,
                std::size_t count) {
  constexpr std::size_t kAtOnce = (std::size_t{1} << 31U) / kMaxPageRows;
  const std::uint32_t float_rows = memory.gaussian_id;
  for (std::size_t first = 0; first < count; first += kAtOnce) {
    const auto some = static_cast<std::uint32_t>(std::min(kAtOnce, count - first));
    for_each_index(stream, items_for(some, float_rows), CopyRows{memory, from + first, to + first, some, float_rows});
  }
}

void copy_ids(StreamView stream, const PageMemory& memory, const std::uint32_t* from, const std::uint32_t* to,
              std::uint32_t count) {
  for_each_index(stream, count, CopyId{memory, from, to});
}

std::vector<PageRemoval> count_dead(StreamView stream, const std::uint8_t* dead, std::span<const LaneRange> pages) {
  const Buffer<LaneRange> on_device = uploaded(stream, pages);
  Buffer<PageRemoval> removals(stream, pages.size());
  for_each_index(stream, static_cast<std::uint32_t>(pages.size()), CountDead{dead, on_device.data(), removals.data()});
  return removals.to_host();
}

void clear_dead_ids(StreamView stream, const PageMemory& memory, const std::uint8_t* dead,
                    std::span<const LaneRange> pages) {
  by_lane(stream, pages, [&](const LaneRange* some) { return ClearDeadIds{memory, dead, some}; });
}

void list_moves(StreamView stream, const std::uint8_t* dead, std::span<const LaneRange> pages,
                std::span<const std::uint32_t> first_move, std::uint32_t* from, std::uint32_t* to) {
  const Buffer<LaneRange> on_device = uploaded(stream, pages);
  const Buffer<std::uint32_t> first = uploaded(stream, first_move);
  for_each_index(stream, static_cast<std::uint32_t>(pages.size()),
                 ListMoves{dead, on_device.data(), first.data(), from, to});
  stream.wait();
}

std::vector<PageBounds> bounds_of_lanes(StreamView stream, const PageMemory& memory, std::span<const LaneRange> lanes) {
  const Buffer<LaneRange> on_device = uploaded(stream, lanes);
  Buffer<PageBounds> bounds(stream, lanes.size());
  for_each_index(stream, static_cast<std::uint32_t>(lanes.size()), BoundLanes{memory, on_device.data(), bounds.data()});
  return bounds.to_host();
}

void write_visibility(StreamView stream, const PageMemory& memory, const std::uint8_t* values,
                      std::span<const LaneRange> pages) {
  by_lane(stream, pages, [&](const LaneRange* some) { return WriteVisibility{memory, values, some}; });
}

void take_averages(StreamView stream, const PageMemory& memory, std::uint32_t channels,
                   std::span<const LaneRange> pages) {
  by_lane(stream, pages, [&](const LaneRange* some) { return TakeAverage{memory, some, channels}; });
}

void mark_broken(StreamView stream, const PageMemory& memory, std::span<const LaneRange> pages, std::uint8_t* dead) {
  by_lane(stream, pages, [&](const LaneRange* some) { return MarkBroken{memory, some, dead}; });
}

}  // namespace splatbus::model
