#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <utility>
#include <vector>

#include "gaussians/light.h"
#include "gaussians/pages.h"
#include "stream/held_gaussians.h"
#include "stream/light_rows.h"
#include "stream/packets.h"
#include "stream/quantized.h"
#include "stream/quantized_scene.h"

namespace splatbus::stream {

/// Rows are given to pages in blocks of so many: a page has as many blocks as it needs.
inline constexpr std::uint32_t kBlockRows = kTierLanes;
inline constexpr std::uint32_t kPageBlocks = kPageLanes / kBlockRows;

/// A page as it is held. Its lane i is row row(i), and stays there until the page's lanes become other Gaussians.
struct HeldPage {
  std::uint32_t version = 0, structure = 0;
  std::uint32_t count = 0;    ///< Gaussians of the page
  std::uint32_t missing = 0;  ///< a bit for each block of lanes that is not of this version yet
  std::uint32_t others = 0;   ///< of those that are missing: what is shown there is of another structure
  std::uint8_t level = 0;
  bool frozen = false;
  std::array<std::uint32_t, kPageBlocks> blocks{};  ///< the first blocks_of(count) are its own
  /// Rows of each that are shown: those that are missing show what they have been before.
  std::array<std::uint32_t, kPageBlocks> shown{};

  [[nodiscard]] static std::uint32_t blocks_of(std::uint32_t count) { return (count + kBlockRows - 1) / kBlockRows; }
  /// Lanes of block k.
  [[nodiscard]] static std::uint32_t block_lanes(std::uint32_t count, std::uint32_t k) {
    return std::min(kBlockRows, count - std::min(count, k * kBlockRows));
  }
  [[nodiscard]] std::uint32_t row(std::uint32_t lane) const {
    return blocks[lane / kBlockRows] * kBlockRows + lane % kBlockRows;
  }
  [[nodiscard]] bool whole() const { return missing == 0; }
};

struct Change;

/// Pages as the integers that travel. Viewers and the streamer hold the same of a page at a version, and change it
/// only by apply(), so that they agree bit for bit; which pages, and in which rows, is everybody's own affair.
struct ReplicatedState {
  StreamLayout layout;
  HeldGaussians gaussians;                  ///< rows of no page hold anything
  std::map<std::uint32_t, HeldPage> pages;  ///< by number
  std::vector<std::uint32_t> free_blocks;   ///< below the rows there are
  std::size_t count = 0;                    ///< Gaussians of the pages, those missing in parts included
  QuantizedScene quantized_scene;
  SceneState scene;  ///< of quantized_scene
  SceneInstant instant;
  LightRows light_rows;                  ///< of scene.light.sources, by row; the sun's is an attribute
  std::uint64_t visibility_version = 0;  ///< newest scene version of any Gaussians' visibility; 0: the model's own
  std::uint64_t epoch = 0;

  [[nodiscard]] std::size_t rows() const { return gaussians.count(); }
  [[nodiscard]] const HeldPage* find(std::uint32_t page) const {
    const auto found = pages.find(page);
    return found != pages.end() ? &found->second : nullptr;
  }
  /// A page's own blocks for `count` lanes, taken or given back; what is in new rows is anything, but seen by all
  /// lights. Notes blocks that are given back in `change`.
  void set_count(HeldPage& page, std::uint32_t count, Change& change);
  /// Gives its rows back.
  void drop(std::uint32_t page, Change& change);
  /// All lanes of a page that is whole are shown.
  static void show(HeldPage& page, Change& change);
  void move_row(std::uint32_t from, std::uint32_t to);
  /// Those of the scene's lights; none where the layout has no visibility. True when they were others.
  bool renew_light_rows();
  /// The page's lanes, in their order.
  [[nodiscard]] QuantizedGaussians lanes(const HeldPage& page) const;
};

/// What apply() changed, in rows.
struct Change {
  struct Values {
    Attribute attribute{};
    std::vector<std::uint32_t> rows;
  };
  struct Seen {
    std::uint32_t light_id = 0;  ///< not the sun
    std::vector<std::uint32_t> rows;
  };
  struct Block {
    std::uint32_t block = 0, count = 0;  ///< rows that are shown, from its first on
  };
  struct Move {
    std::uint32_t from = 0, to = 0;
  };
  bool layout = false;                  ///< everything before is gone
  std::vector<std::uint32_t> rows;      ///< all values of them are others; in no order
  std::vector<std::uint32_t> arrivals;  ///< of `rows`: their Gaussians were in no row before
  std::vector<Values> values;
  std::vector<std::uint32_t> objects;
  std::vector<Seen> seen;
  std::vector<Block> blocks;  ///< whose count is another, a page's own or a free one's
  std::vector<Move> moves;    ///< rows that were copied, all at once, before anything else; `rows` has the targets
  std::vector<std::uint32_t> taken;     ///< pages that are new, or of which anything is another than before
  std::vector<std::uint32_t> gone;      ///< pages
  std::vector<std::uint32_t> lacks;     ///< pages that the packet says something of which does not fit what is held
  std::vector<std::uint32_t> declined;  ///< pages for which there is no room
  bool scene = false, lights = false;   ///< lights: there are others

  [[nodiscard]] bool shows() const {
    return layout || !rows.empty() || !values.empty() || !objects.empty() || !seen.empty() || !blocks.empty() || scene;
  }
};

/// Applies Page, PageDelta, PagesGone, LightVisibility or Scene. Throws StreamError, with the state as it was, when
/// anything in the packet cannot be. What cannot be applied to what is held is no error: Change::lacks names it, and a
/// Scene against another one than the held throws SceneLost. Does not look at the epoch. `max_gaussians` bounds what is
/// held.
Change apply(ReplicatedState& state, const ParsedPacket& packet, std::size_t max_gaussians = kMaxGaussians);

/// A Scene is against one that is not held; a whole one helps.
class SceneLost : public StreamError {
 public:
  using StreamError::StreamError;
};

/// Lanes [0, count - gone) as the lanes [0, count) that they were, after those at the end have filled the gaps of
/// `gone`, which ascends.
[[nodiscard]] std::vector<std::uint32_t> lanes_after(std::uint32_t count, std::span<const std::uint32_t> gone);

// apply()'s parts.
[[nodiscard]] Change apply_page(ReplicatedState& state, const wire::Page& body, std::span<const std::uint8_t> payload,
                                std::size_t max_gaussians);
[[nodiscard]] Change apply_delta(ReplicatedState& state, const wire::PageDelta& body,
                                 std::span<const std::uint8_t> payload, std::size_t max_gaussians);

/// Whether so many more Gaussians in so many more blocks may be held.
[[nodiscard]] bool has_room(const ReplicatedState& state, std::size_t gaussians, std::size_t blocks,
                            std::size_t max_gaussians);

/// Cuts a payload into the parts that a packet says, in order. Throws StreamError when they are not all of it.
class PayloadParts {
 public:
  PayloadParts(std::span<const std::uint8_t> payload, std::string_view what) : left_(payload), what_(what) {}
  [[nodiscard]] std::span<const std::uint8_t> next(std::size_t bytes);
  void finish() const;

 private:
  std::span<const std::uint8_t> left_;
  std::string_view what_;
};

}  // namespace splatbus::stream
