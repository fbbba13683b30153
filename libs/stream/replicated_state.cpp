#include "stream/replicated_state.h"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "stream/bytes.h"
#include "stream/codecs.h"
#include "stream/scene_codec.h"

namespace splatbus::stream {

namespace {

constexpr std::size_t kSpareBlocks = 256;

Change take_visibility(ReplicatedState& state, const wire::LightVisibility& body,
                       std::span<const std::uint8_t> payload) {
  const AttributeChannels* a = state.layout.find(Attribute::Visibility);
  if (!a) throw StreamError("LightVisibility: this stream has no visibility");
  if (body.scene_version() < state.visibility_version) {
    throw StreamError(fmt::format("LightVisibility: of scene version {} where {} is held", body.scene_version(),
                                  state.visibility_version));
  }
  Bytes* row = body.light_id() != 0 ? state.light_rows.find(body.light_id()) : nullptr;
  if (body.light_id() != 0 && !row) {
    throw StreamError(fmt::format("LightVisibility: of light {}, which the scene does not have", body.light_id()));
  }
  if (body.pages()->size() > kMaxDeltaPages) {
    throw StreamError(
        fmt::format("LightVisibility: {} pages, at most {} are possible", body.pages()->size(), kMaxDeltaPages));
  }
  struct Lanes {
    std::size_t end;
    const HeldPage* page;
  };
  Change change;
  std::vector<Lanes> lanes;
  std::size_t total = 0;
  for (const wire::SeenPage* said : *body.pages()) {
    if (said->count() > kPageLanes) {
      throw StreamError(fmt::format("LightVisibility: page {} of {} Gaussians", said->page(), said->count()));
    }
    const HeldPage* page = state.find(said->page());
    const bool fits = page && page->whole() && page->structure == said->structure();
    if (fits && page->count != said->count()) {
      throw StreamError(fmt::format("LightVisibility: page {} of {} Gaussians, {} are held", said->page(),
                                    said->count(), page->count));
    }
    total += said->count();
    lanes.push_back({total, fits ? page : nullptr});
  }
  const SlotValues values = decode_slot_values(payload, body.raw_bytes(), body.count(), total);
  std::vector<std::uint32_t> rows;
  std::vector<std::uint8_t> seen;
  std::size_t at = 0;
  for (std::size_t i = 0; i < values.slots.size(); ++i) {
    while (values.slots[i] >= lanes[at].end) ++at;
    if (!lanes[at].page) continue;
    const auto first = static_cast<std::uint32_t>(at > 0 ? lanes[at - 1].end : 0);
    rows.push_back(lanes[at].page->row(values.slots[i] - first));
    seen.push_back(values.values[i]);
  }
  state.visibility_version = body.scene_version();
  if (rows.empty()) return change;
  if (row) {
    for (std::size_t i = 0; i < rows.size(); ++i) (*row)[rows[i]] = seen[i];
    change.seen.push_back({body.light_id(), std::move(rows)});
  } else {
    auto& plane = state.gaussians.channels[a->first];
    for (std::size_t i = 0; i < rows.size(); ++i) plane.set(rows[i], seen[i]);
    change.values.push_back({Attribute::Visibility, std::move(rows)});
  }
  return change;
}

Change take_scene(ReplicatedState& state, const ParsedPacket& packet) {
  const wire::Scene& body = *packet.root().body_as_Scene();
  const bool whole = body.from_version() == 0;
  if (body.version() < state.quantized_scene.version || body.version() == 0) {
    throw StreamError(fmt::format("Scene: version {} where {} is held", body.version(), state.quantized_scene.version));
  }
  if (!whole && body.from_version() != state.quantized_scene.version) {
    throw SceneLost(
        fmt::format("Scene: against version {} where {} is held", body.from_version(), state.quantized_scene.version));
  }
  QuantizedScene scene = decode_scene({body.state()->data(), body.state()->size()},
                                      whole ? nullptr : &state.quantized_scene, body.version());
  dequantize_changes(state.quantized_scene, scene, state.scene);
  state.quantized_scene = std::move(scene);
  state.instant = {.frame = body.frame(), .capture_ns = packet.capture_ns()};
  Change change;
  change.scene = true;
  change.lights = state.renew_light_rows();
  return change;
}

Change drop_pages(ReplicatedState& state, const wire::PagesGone& body) {
  Change change;
  for (const std::uint32_t number : *body.pages()) state.drop(number, change);
  return change;
}

}  // namespace

bool ReplicatedState::renew_light_rows() {
  std::vector<std::uint32_t> ids;
  if (layout.find(Attribute::Visibility)) {
    for (const QuantizedSource& source : quantized_scene.sources) ids.push_back(source.id);
  }
  return light_rows.set_lights(ids, rows());
}

void ReplicatedState::set_count(HeldPage& page, std::uint32_t new_count, Change& change) {
  const std::uint32_t before = HeldPage::blocks_of(page.count), after = HeldPage::blocks_of(new_count);
  for (std::uint32_t lane = new_count; lane < page.count; ++lane) gaussians.gaussian_id.set(page.row(lane), 0);
  for (std::uint32_t k = after; k < before; ++k) {
    free_blocks.push_back(page.blocks[k]);
    change.blocks.push_back({page.blocks[k], page.shown[k] = 0});
  }
  for (std::uint32_t k = before; k < after; ++k) {
    if (free_blocks.empty()) {
      const std::size_t rows_before = rows();
      gaussians.grow();
      light_rows.resize(rows());
      for (std::size_t block = rows() / kBlockRows; block > rows_before / kBlockRows; --block) {
        free_blocks.push_back(static_cast<std::uint32_t>(block - 1));
      }
    }
    page.blocks[k] = free_blocks.back();
    free_blocks.pop_back();
  }
  for (std::uint32_t lane = page.count; lane < new_count; ++lane) light_rows.forget(page.row(lane));
  count += new_count;
  count -= page.count;
  page.count = new_count;
}

void ReplicatedState::drop(std::uint32_t number, Change& change) {
  const auto found = pages.find(number);
  if (found == pages.end()) return;
  set_count(found->second, 0, change);
  pages.erase(found);
  change.gone.push_back(number);
}

void ReplicatedState::show(HeldPage& page, Change& change) {
  for (std::uint32_t k = 0; k < HeldPage::blocks_of(page.count); ++k) {
    const std::uint32_t lanes = HeldPage::block_lanes(page.count, k);
    if (std::exchange(page.shown[k], lanes) != lanes) change.blocks.push_back({page.blocks[k], lanes});
  }
}

void ReplicatedState::move_row(std::uint32_t from, std::uint32_t to) {
  gaussians.move(from, to);
  light_rows.move(from, to);
}

QuantizedGaussians ReplicatedState::lanes(const HeldPage& page) const {
  std::vector<std::uint32_t> columns(page.count);
  for (std::uint32_t lane = 0; lane < page.count; ++lane) columns[lane] = page.row(lane);
  return gaussians.gather(columns);
}

bool has_room(const ReplicatedState& state, std::size_t gaussians, std::size_t blocks, std::size_t max_gaussians) {
  const std::size_t used = state.rows() / kBlockRows - state.free_blocks.size();
  return state.count + gaussians <= max_gaussians && used + blocks <= 2 * max_gaussians / kBlockRows + kSpareBlocks;
}

std::span<const std::uint8_t> PayloadParts::next(std::size_t bytes) {
  if (bytes > left_.size()) {
    throw StreamError(fmt::format("{}: a part of {} bytes where {} are left", what_, bytes, left_.size()));
  }
  const auto part = left_.first(bytes);
  left_ = left_.subspan(bytes);
  return part;
}

void PayloadParts::finish() const {
  if (!left_.empty()) throw StreamError(fmt::format("{}: {} bytes behind its parts", what_, left_.size()));
}

std::vector<std::uint32_t> lanes_after(std::uint32_t count, std::span<const std::uint32_t> gone) {
  const auto left = static_cast<std::uint32_t>(count - gone.size());
  std::vector<std::uint32_t> lanes(left);
  for (std::uint32_t lane = 0; lane < left; ++lane) lanes[lane] = lane;
  std::size_t behind = static_cast<std::size_t>(std::lower_bound(gone.begin(), gone.end(), left) - gone.begin());
  std::uint32_t last = left;
  for (const std::uint32_t gap : gone.first(behind)) {
    while (behind < gone.size() && gone[behind] == last) {
      ++behind;
      ++last;
    }
    lanes[gap] = last++;
  }
  return lanes;
}

Change apply(ReplicatedState& state, const ParsedPacket& packet, std::size_t max_gaussians) {
  const wire::Packet& root = packet.root();
  switch (packet.body()) {
    case wire::Body::Page:
      return apply_page(state, *root.body_as_Page(), packet.payload(), max_gaussians);
    case wire::Body::PageDelta:
      return apply_delta(state, *root.body_as_PageDelta(), packet.payload(), max_gaussians);
    case wire::Body::PagesGone:
      return drop_pages(state, *root.body_as_PagesGone());
    case wire::Body::LightVisibility:
      return take_visibility(state, *root.body_as_LightVisibility(), packet.payload());
    case wire::Body::Scene:
      return take_scene(state, packet);
    default:
      throw StreamError(fmt::format("{}: not a packet that changes what is held", wire::EnumNameBody(packet.body())));
  }
}

}  // namespace splatbus::stream
