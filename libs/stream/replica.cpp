#include "stream/replica.h"

#include <fmt/format.h>

#include <algorithm>
#include <numeric>
#include <utility>

#include "stream/bytes.h"

namespace splatbus::stream {

namespace {

constexpr std::size_t kMinChanges = std::size_t{1} << 20;  // bytes; below that a whole is not worth its while
constexpr std::size_t kMaxReported = 4096;
constexpr std::size_t kMaxManifest = std::size_t{1} << 18;  // pages
constexpr double kEnoughOfBefore = 0.9;

/// The rows of all blocks that are shown.
std::vector<std::uint32_t> shown_rows(const ReplicatedState& state) {
  std::vector<std::uint32_t> rows;
  for (const auto& [number, page] : state.pages) {
    for (std::uint32_t k = 0; k < HeldPage::blocks_of(page.count); ++k) {
      for (std::uint32_t i = 0; i < page.shown[k]; ++i) rows.push_back(page.blocks[k] * kBlockRows + i);
    }
  }
  return rows;
}

Bytes values_of(const Bytes& row, const std::vector<std::uint32_t>& rows) {
  Bytes values;
  values.reserve(rows.size());
  for (const std::uint32_t r : rows) values.push_back(row[r]);
  return values;
}

Bytes sun_of(const ReplicatedState& state, const std::vector<std::uint32_t>& rows) {
  Bytes values;
  if (const AttributeChannels* a = state.layout.find(Attribute::Visibility)) {
    const HeldChannel& plane = state.gaussians.channels[a->first];
    for (const std::uint32_t row : rows) values.push_back(static_cast<std::uint8_t>(plane[row]));
  }
  return values;
}

}  // namespace

bool Replica::receive(const ParsedPacket& packet) {
  if (packet.body() == wire::Body::Welcome) {
    welcome(*packet.root().body_as_Welcome());
    return false;
  }
  number(packet);
  if (packet.body() == wire::Body::Layout) {
    begin(*packet.root().body_as_Layout(), packet.stream_epoch());
    return false;
  }
  if (packet.stream_epoch() != epoch() || epoch() == 0) return false;
  switch (packet.body()) {
    case wire::Body::Manifest:
      take_manifest(*packet.root().body_as_Manifest());
      return false;
    case wire::Body::Page:
    case wire::Body::PageDelta:
    case wire::Body::PagesGone:
    case wire::Body::LightVisibility:
    case wire::Body::Scene:
      return take(packet);
    default:
      return false;
  }
}

void Replica::welcome(const wire::Welcome& body) {
  if (body.asks() || body.connection() == connection_) return;
  connection_ = body.connection();
  report_ = {};
}

void Replica::number(const ParsedPacket& packet) {
  const std::uint64_t sequence = packet.sequence();
  if (sequence <= report_.newest) return;
  if (sequence > report_.newest + 1 && report_.missing.size() < kMaxReported) {
    report_.missing.push_back({report_.newest + 1, sequence - 1});
  }
  report_.newest = sequence;
}

void Replica::clear_report() {
  report_ = {.newest = report_.newest, .missing = {}, .lacks = {}, .dropped = {}, .scene_lost = false};
}

void Replica::lack(std::uint32_t page) {
  const HeldPage* known = held_->find(page);
  if (known && !known->whole()) return;  // its parts are on their way
  if (report_.lacks.size() >= kMaxReported) return;
  const auto same = [&](const PageVersion& lacked) { return lacked.page == page; };
  if (std::any_of(report_.lacks.begin(), report_.lacks.end(), same)) return;
  report_.lacks.push_back({page, known ? known->version : 0});
}

void Replica::begin(const wire::Layout& body, std::uint64_t epoch) {
  if (epoch == 0) throw StreamError("Layout: no stream epoch");
  StreamLayout layout = StreamLayout::from_wire(body);
  if (epoch == this->epoch()) {
    if (layout != held_->layout) throw StreamError("Layout: it differs from that of its epoch");
    return;
  }
  auto next = std::make_unique<ReplicatedState>();
  next->layout = std::move(layout);
  next->gaussians = HeldGaussians(next->layout);
  next->epoch = epoch;
  manifest_.clear();
  manifest_gaussians_ = 0;
  manifest_whole_ = false;
  if (!before_ && held_->count > 0) before_ = std::move(held_);
  held_ = std::move(next);
  if (!before_) show_whole();
}

void Replica::take_manifest(const wire::Manifest& body) {
  if (manifest_.size() + body.pages()->size() > kMaxManifest) {
    throw StreamError(fmt::format("Manifest: more than {} pages", kMaxManifest));
  }
  if (body.whole()) manifest_.clear();
  for (const wire::PageInfo* page : *body.pages()) manifest_[page->page()] = page->count();
  if (body.gone()) {
    for (const std::uint32_t page : *body.gone()) manifest_.erase(page);
  }
  manifest_gaussians_ = body.gaussians();
  manifest_whole_ = !body.more();
  replace_before();
}

bool Replica::take(const ParsedPacket& packet) {
  Change change;
  try {
    change = apply(*held_, packet, max_gaussians_);
  } catch (const SceneLost&) {
    report_.scene_lost = true;
    return false;
  }
  if (!report_.lacks.empty()) {  // what was lacking may have come
    std::erase_if(report_.lacks, [&](const PageVersion& lacking) {
      return std::find(change.taken.begin(), change.taken.end(), lacking.page) != change.taken.end();
    });
  }
  for (const std::uint32_t page : change.lacks) lack(page);
  for (const std::uint32_t page : change.declined) {
    if (report_.dropped.size() < kMaxReported) report_.dropped.push_back(page);
  }
  if (!before_) {
    note(change);
    return change.shows();
  }
  replace_before();
  return !before_ || change.scene;
}

void Replica::replace_before() {
  if (!before_) return;
  const bool enough = static_cast<double>(held_->count) >= kEnoughOfBefore * static_cast<double>(before_->count);
  const bool all = manifest_whole_ && missing_pages() == 0;
  if (!enough && !all) return;
  before_.reset();
  show_whole();
}

void Replica::note(const Change& change) {
  const ReplicatedState& state = *held_;
  if (observer_) {
    if (change.shows()) observer_->on_change(state, change);
    return;
  }
  if (state.visibility_version != noted_visibility_) {
    noted_visibility_ = state.visibility_version;
    note(DisplayVisibility{noted_visibility_});
  }
  if (change.lights) {
    note(DisplayLights{state.light_rows.ids()});
    if (!state.light_rows.all().empty()) {
      const auto rows = shown_rows(state);
      note(DisplaySeen{0, rows, sun_of(state, rows)});
    }
  }
  // A row that was given back in the same packet is nobody's, and shows nothing.
  if (!change.rows.empty()) note(DisplayRows{change.rows, state.gaussians.gather(change.rows)});
  for (const Change::Values& changed : change.values) {
    const AttributeChannels& a = state.layout.at(changed.attribute);
    DisplayValues values{.attribute = changed.attribute, .rows = changed.rows, .values = {}};
    values.values.reserve(static_cast<std::size_t>(a.channels) * changed.rows.size());
    for (int c = a.first; c < a.first + a.channels; ++c) {
      for (const std::uint32_t row : changed.rows) values.values.push_back(state.gaussians.channels[c][row]);
    }
    if (changed.attribute == Attribute::Visibility && !state.light_rows.all().empty()) {
      note(DisplaySeen{0, changed.rows, Bytes(values.values.begin(), values.values.end())});
    }
    note(std::move(values));
  }
  if (!change.objects.empty()) {
    DisplayObjects objects{.rows = change.objects, .object_ids = {}};
    for (const std::uint32_t row : change.objects) objects.object_ids.push_back(state.gaussians.object_id[row]);
    note(std::move(objects));
  }
  for (const Change::Seen& seen : change.seen) {
    note(DisplaySeen{seen.light_id, seen.rows, values_of(*state.light_rows.find(seen.light_id), seen.rows)});
  }
  if (!change.blocks.empty()) {
    DisplayBlocks blocks;
    for (const auto& [block, count] : change.blocks) blocks.blocks.push_back({block, count});
    note(std::move(blocks));
  }
}

void Replica::note(DisplayChange change) {
  changes_.add(std::move(change));
  if (exceeds_whole(changes_)) show_whole();
}

void Replica::show_whole() {
  noted_visibility_ = shown().visibility_version;
  if (observer_) {
    observer_->on_reset(shown());
  } else {
    changes_ = whole();
  }
}

void Replica::observe_with(ShownObserver& observer) {
  observer_ = &observer;
  changes_.clear();
  show_whole();
}

bool Replica::exceeds_whole(const DisplayChanges& changes) const {
  const ReplicatedState& state = shown();
  const std::size_t lights = 5 * state.light_rows.all().size() * state.rows();
  return changes.bytes() > kMinChanges + 2 * (display_bytes(state.gaussians.channels.size(), state.count) + lights);
}

DisplayChanges Replica::take_changes() {
  return std::exchange(changes_, {});
}

DisplayChanges Replica::whole() const {
  const ReplicatedState& state = shown();
  DisplayChanges out;
  out.add(DisplayReset{state.layout});
  out.add(DisplayVisibility{state.visibility_version});
  if (!state.light_rows.all().empty()) out.add(DisplayLights{state.light_rows.ids()});
  const std::vector<std::uint32_t> rows = shown_rows(state);
  if (rows.empty()) return out;
  out.add(DisplayRows{rows, state.gaussians.gather(rows)});
  for (const auto& [id, row] : state.light_rows.all()) out.add(DisplaySeen{id, rows, values_of(row, rows)});
  DisplayBlocks blocks;
  for (const auto& [number, page] : state.pages) {
    for (std::uint32_t k = 0; k < HeldPage::blocks_of(page.count); ++k) {
      blocks.blocks.push_back({page.blocks[k], page.shown[k]});
    }
  }
  out.add(std::move(blocks));
  return out;
}

std::vector<PageVersion> Replica::held_pages() const {
  std::vector<PageVersion> pages;
  for (const auto& [number, page] : held_->pages) {
    if (page.whole()) pages.push_back({number, page.version});
  }
  return pages;
}

std::size_t Replica::missing_pages() const {
  return static_cast<std::size_t>(std::count_if(manifest_.begin(), manifest_.end(), [&](const auto& entry) {
    const HeldPage* page = held_->find(entry.first);
    return !page || !page->whole();
  }));
}

const ReplicatedState& Replica::scene_state() const {
  return before_ && held_->quantized_scene.version == 0 ? *before_ : *held_;
}

}  // namespace splatbus::stream
