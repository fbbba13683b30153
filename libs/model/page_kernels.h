#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "device/buffer.h"
#include "gaussians/pages.h"
#include "model/channels.h"
#include "model/insert_rows.h"

// What a PageStore does where its pages lie, written once for both devices. Pointers are to memory of the stream's
// device but where a std::span or a std::vector says the host's; what returns a value has waited for it.
namespace splatbus::model {

using device::Buffer;
using device::StreamView;

SPLATBUS_PORTABLE std::uint64_t spread_bits(std::uint64_t x) {
  x &= 0x1fffffU;
  x = (x | x << 32U) & 0x1f00000000ffffU;
  x = (x | x << 16U) & 0x1f0000ff0000ffU;
  x = (x | x << 8U) & 0x100f00f00f00f00fU;
  x = (x | x << 4U) & 0x10c30c30c30c30c3U;
  return (x | x << 2U) & 0x1249249249249249U;
}

/// Position along a Morton curve, 21 bits an axis of 1 cm around the origin (10.48 km either way).
SPLATBUS_PORTABLE std::uint64_t morton_key(const math::Vec3& position_m) {
  const auto bits = [](float metres) {
    constexpr float kPerMetre = 100, kHalf = 1048576;
    return static_cast<std::uint64_t>(math::clamped(floorf(metres * kPerMetre) + kHalf, 0.0F, 2 * kHalf - 1));
  };
  return spread_bits(bits(position_m.x)) | spread_bits(bits(position_m.y)) << 1U |
         spread_bits(bits(position_m.z)) << 2U;
}

/// A Gaussian on its way to a page. Within a frame of reference, or a group, they are in order of Morton key and id.
struct Item {
  std::uint64_t morton, id;
  std::uint32_t group;   ///< frame of reference; of what is split, the split's number
  std::uint32_t source;  ///< number of the new Gaussian, or kFromPage and the index where it lies
};
inline constexpr std::uint32_t kFromPage = 0x80000000U;

/// Where a page of the directory begins, in the items' order, and where its new Gaussians go.
struct Bound {
  std::uint64_t morton, id;
  std::uint32_t frame_id;
};
struct Append {
  std::uint32_t first_item = 0;
  std::uint32_t index = kNotInserted;  ///< of its first new Gaussian; kNotInserted: they go with a split
  std::uint32_t room = 0;              ///< Gaussians beyond these are not inserted
};

/// What a page that is not here holds: Gaussians of its frame whose Morton keys and positions are within.
struct SpilledRange {
  std::uint32_t frame_id = kWorldFrame;
  std::uint64_t morton_first = 0, id_first = 0;  ///< the page's key
  std::uint64_t morton_last = 0;                 ///< the highest
  math::Vec3 low_m, high_m;
};

/// A page and items that are to be spread evenly over new pages.
struct Split {
  std::uint32_t first;  ///< of its items among those of all splits
  std::uint32_t old_index, old_count;
  std::uint32_t first_item, item_count;
  std::uint32_t first_new_page, new_page_count;  ///< in the list of new pages
};

struct LaneRange {
  std::uint32_t first = 0, count = 0;  ///< indices, of one page
};

/// Lanes that move together; `first` of them move before.
struct LaneMove {
  std::uint32_t from, to, count, first;
};

struct PageRemoval {
  std::uint32_t dead = 0, holes = 0;  ///< holes: dead lanes below those that stay
};

// New Gaussians, in order. Ids are first_id + number.
void list_rows(StreamView stream, const InsertRows& rows, std::uint32_t count, std::uint64_t first_id, Item* items);
/// Takes out the rows that lie in pages which are not here, `spilled` ascending. Returns how many items are left.
[[nodiscard]] std::uint32_t drop_spilled(StreamView stream, const InsertRows& rows,
                                         std::span<const SpilledRange> spilled, Item* items, std::uint32_t count);
/// `ranges`, ascending, say which frame the page of an index is in.
void list_copies(StreamView stream, const PageMemory& memory, const std::uint32_t* indices, std::uint32_t count,
                 const IndexRange* ranges, std::uint32_t range_count, std::uint64_t first_id, Item* items);
void sort_items(StreamView stream, Item* items, std::uint32_t count);
/// Groups of sorted items, ascending.
[[nodiscard]] std::vector<std::uint32_t> list_groups(StreamView stream, const Item* items, std::uint32_t count);
/// First item of each page; bounds ascending.
[[nodiscard]] std::vector<std::uint32_t> first_items(StreamView stream, const Item* items, std::uint32_t count,
                                                     std::span<const Bound> bounds);

/// to[number] = index, for those that a page has room for as it is.
void place_appends(StreamView stream, const Item* items, std::uint32_t count, std::span<const Append> appends,
                   std::uint32_t* to);
/// Places the items of splits, and lists the moves of what lay in old pages: [sum of old_count]. Returns the first key
/// of every new page.
[[nodiscard]] std::vector<Bound> place_splits(StreamView stream, const PageMemory& memory, const Item* items,
                                              std::span<const Split> splits, std::span<const std::uint32_t> new_pages,
                                              std::uint32_t* to, std::uint32_t* moved_from, std::uint32_t* moved_to);

/// What a row starts with in Radiance: the constant band of the lit colour, display space (Kerbl et al. 2023),
/// [3][count].
void light_rows(StreamView stream, const InsertRows& rows, std::uint32_t count, const InsertLight& light,
                std::span<const ObjectRotation> objects, float* dc);
/// Writes row k to index to[k], in the order of the items. `appearance`: albedo, or what light_rows() made, of
/// `appearance_stride`.
void write_rows(StreamView stream, const PageMemory& memory, const ParameterLayout& layout, const InsertRows& rows,
                const float* appearance, std::size_t appearance_stride, const Item* items, std::uint32_t count,
                const std::uint32_t* to);
/// gaussian_id of index to[k] = first_id + k.
void number(StreamView stream, const PageMemory& memory, const std::uint32_t* to, std::uint32_t count,
            std::uint64_t first_id);
/// Copies all channels from from[k] to to[k], but the id.
void copy_lanes(StreamView stream, const PageMemory& memory, const std::uint32_t* from, const std::uint32_t* to,
                std::size_t count);
void copy_ids(StreamView stream, const PageMemory& memory, const std::uint32_t* from, const std::uint32_t* to,
              std::uint32_t count);

[[nodiscard]] std::vector<PageRemoval> count_dead(StreamView stream, const std::uint8_t* dead,
                                                  std::span<const LaneRange> pages);
void clear_dead_ids(StreamView stream, const PageMemory& memory, const std::uint8_t* dead,
                    std::span<const LaneRange> pages);
/// Of page p, moves [first_move[p], first_move[p] + holes): the last that stay, into the holes.
void list_moves(StreamView stream, const std::uint8_t* dead, std::span<const LaneRange> pages,
                std::span<const std::uint32_t> first_move, std::uint32_t* from, std::uint32_t* to);

void list_moves(StreamView stream, std::span<const LaneMove> lanes, std::uint32_t* from, std::uint32_t* to);

/// Of each range of lanes.
[[nodiscard]] std::vector<PageBounds> bounds_of_lanes(StreamView stream, const PageMemory& memory,
                                                      std::span<const LaneRange> lanes);
/// Clamped to [0, 1]; what is no number becomes 0.
void write_visibility(StreamView stream, const PageMemory& memory, const std::uint8_t* values,
                      std::span<const LaneRange> pages);
/// The parameters, of which there are `channels`, become what their averages are.
void take_averages(StreamView stream, const PageMemory& memory, std::uint32_t channels,
                   std::span<const LaneRange> pages);
/// dead[i] = 1 where the Gaussian is not finite or has no id; `dead` is zero before.
void mark_broken(StreamView stream, const PageMemory& memory, std::span<const LaneRange> pages, std::uint8_t* dead);

}  // namespace splatbus::model
