#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "stream/all_seen.h"
#include "stream/bytes.h"
#include "stream/page_codec.h"
#include "stream/replicated_state.h"

namespace splatbus::stream {

namespace {

void require_sense(const wire::Page& body) {
  const std::uint32_t first = body.first(), part = body.part(), count = body.count();
  const bool parts = first % kBlockRows == 0 && part > 0 && first < count && part <= count - first &&
                     (part % kBlockRows == 0 || first + part == count);
  if (body.page() >= kMaxPageNumber || count > kPageLanes || !parts || body.version() == 0 || body.structure() == 0 ||
      body.structure() > body.version() || !is_page_codec(body.codec())) {
    throw StreamError(fmt::format("Page: {} at version {} (structure {}), lanes {} + {} of {}, codec {}", body.page(),
                                  body.version(), body.structure(), first, part, count, body.codec()));
  }
}

struct SeenValues {
  std::uint32_t light_id;
  Bytes values;  ///< [part]
};

std::vector<SeenValues> read_seen(const wire::Page& body, PayloadParts& parts) {
  std::vector<SeenValues> seen;
  if (!body.seen()) return seen;
  if (body.seen()->size() > 1 + kMaxLightSources) {
    throw StreamError(
        fmt::format("Page: {} lights, at most {} are possible", body.seen()->size(), 1 + kMaxLightSources));
  }
  for (const wire::SeenRow* row : *body.seen()) {
    if (row->raw_bytes() != body.part() || (!seen.empty() && row->light_id() <= seen.back().light_id)) {
      throw StreamError(fmt::format("Page: {} values of light {}", row->raw_bytes(), row->light_id()));
    }
    seen.push_back({row->light_id(), zstd_decompress(parts.next(row->bytes()), row->raw_bytes(), "Page")});
  }
  return seen;
}

}  // namespace

Change apply_page(ReplicatedState& state, const wire::Page& body, std::span<const std::uint8_t> payload,
                  std::size_t max_gaussians) {
  require_sense(body);
  PayloadParts parts(payload, "Page");
  const QuantizedGaussians lanes =
      decode_page(parts.next(body.blob_bytes()), state.layout, static_cast<PageCodec>(body.codec()), body.part());
  const std::vector<SeenValues> seen = read_seen(body, parts);
  parts.finish();

  Change change;
  const HeldPage* before = state.find(body.page());
  if (before && before->version > body.version()) return change;
  const bool same = before && before->version == body.version();
  if (same && (before->count != body.count() || before->structure != body.structure())) {
    throw StreamError(
        fmt::format("Page: {} at version {} differs from the one that is held", body.page(), body.version()));
  }
  const std::uint32_t held = before ? before->count : 0;
  const std::uint32_t more = body.count() - std::min(body.count(), held);
  const std::uint32_t blocks =
      HeldPage::blocks_of(body.count()) - std::min(HeldPage::blocks_of(body.count()), HeldPage::blocks_of(held));
  if (!has_room(state, more, blocks, max_gaussians)) {
    change.declined.push_back(body.page());
    return change;
  }

  HeldPage& page = state.pages[body.page()];
  state.set_count(page, body.count(), change);
  if (!same) {
    page.others = page.structure == body.structure() ? page.others & page.missing : ~0U;
    page.version = body.version();
    page.structure = body.structure();
    page.missing = (1U << HeldPage::blocks_of(page.count)) - 1;
    for (std::uint32_t k = 0; k < kPageBlocks; ++k) {
      const std::uint32_t most = HeldPage::block_lanes(page.count, k);
      if (page.shown[k] > most) change.blocks.push_back({page.blocks[k], page.shown[k] = most});
    }
  }
  page.level = body.level();
  page.frozen = body.frozen();
  const AttributeChannels* sun = state.layout.find(Attribute::Visibility);
  for (std::uint32_t lane = body.first(); lane < body.first() + body.part(); ++lane) {
    const std::uint32_t row = page.row(lane), block = lane / kBlockRows;
    change.rows.push_back(row);
    if ((page.others >> block & 1U) != 0 || lane % kBlockRows >= page.shown[block]) change.arrivals.push_back(row);
  }
  state.gaussians.write(change.rows, lanes, 0);
  for (const std::uint32_t row : change.rows) {
    if (sun) state.gaussians.channels[sun->first].set(row, kAllSeen);
    state.light_rows.forget(row);
  }
  for (const SeenValues& light : seen) {
    Bytes* others = light.light_id != 0 ? state.light_rows.find(light.light_id) : nullptr;
    for (std::uint32_t i = 0; i < body.part(); ++i) {
      const std::uint32_t row = page.row(body.first() + i);
      if (light.light_id == 0 && sun) state.gaussians.channels[sun->first].set(row, light.values[i]);
      if (others) (*others)[row] = light.values[i];
    }
  }
  for (const auto& [id, row] : state.light_rows.all()) change.seen.push_back({id, change.rows});
  const std::uint32_t end = HeldPage::blocks_of(body.first() + body.part());
  for (std::uint32_t k = body.first() / kBlockRows; k < end; ++k) {
    page.missing &= ~(1U << k);
    page.others &= ~(1U << k);
    const std::uint32_t shown = HeldPage::block_lanes(page.count, k);
    if (std::exchange(page.shown[k], shown) != shown) change.blocks.push_back({page.blocks[k], shown});
  }
  change.taken.push_back(body.page());
  return change;
}

}  // namespace splatbus::stream
