#include <algorithm>
#include <numeric>
#include <utility>

#include "stream/all_seen.h"
#include "stream/codecs.h"
#include "stream/stream_model.h"

namespace splatbus::stream {

namespace {

constexpr std::size_t kManifestPages = 100;  // in one packet: few bytes, for slow viewers

wire::Vec3 to_wire(const math::Vec3& v) {
  return {v.x, v.y, v.z};
}

bool all_seen(const Bytes& row) {
  return std::ranges::all_of(row, [](std::uint8_t value) { return value == kAllSeen; });
}

}  // namespace

StreamUpdate StreamModel::take_update() {
  const std::scoped_lock lock(mutex_);
  return std::exchange(update_, {});
}

StreamModel::Status StreamModel::status() const {
  const std::scoped_lock lock(mutex_);
  return {.ready = ready_,
          .epoch = held_.epoch,
          .visibility_version = held_.visibility_version,
          .version = version_,
          .gaussians = held_.count,
          .pages = held_.pages.size(),
          .layout = held_.layout.parameters(),
          .mean_step = held_.layout.at(Attribute::Mean).quantizer.step};
}

std::shared_ptr<const std::vector<OfferedPage>> StreamModel::offered() const {
  const std::scoped_lock lock(mutex_);
  return offered_;
}

EncodedPacket StreamModel::layout_packet() const {
  const std::scoped_lock lock(mutex_);
  return writer_.write(held_.epoch, 0, wire::Body::Layout, [&](auto& builder) {
    std::vector<flatbuffers::Offset<wire::TensorMetadata>> attributes;
    for (const AttributeChannels& a : held_.layout.attributes()) {
      const wire::Quantizer quantizer(a.quantizer.offset, a.quantizer.step);
      attributes.push_back(
          wire::CreateTensorMetadata(builder, a.attribute, static_cast<std::uint32_t>(a.channels), &quantizer));
    }
    const ParameterLayout& parameters = held_.layout.parameters();
    const bool transfer = parameters.appearance == Appearance::Transfer;
    return wire::CreateLayout(builder, transfer ? wire::Appearance::Transfer : wire::Appearance::Radiance,
                              static_cast<std::uint8_t>(transfer ? 0 : parameters.sh_degree),
                              builder.CreateVector(attributes), kPageLanes);
  });
}

std::vector<PagePacket> StreamModel::page_packets(std::uint32_t number, std::uint32_t part_lanes, bool to_hold) {
  QuantizedGaussians lanes;
  HeldPage page;
  std::map<std::uint32_t, Bytes> seen;  // by light
  StreamLayout layout;
  std::uint64_t epoch = 0;
  std::map<std::pair<std::uint32_t, std::uint32_t>, std::shared_ptr<const Bytes>> parts;
  {
    const std::scoped_lock lock(mutex_);
    const HeldPage* held = held_.find(number);
    if (!ready_ || !held) return {};
    page = *held;
    lanes = held_.lanes(page);
    layout = held_.layout;
    epoch = held_.epoch;
    if (to_hold) asked_.insert(number);
    if (const AttributeChannels* sun = layout.find(Attribute::Visibility)) {
      std::vector<std::int32_t>& plane = lanes.channels[static_cast<std::size_t>(sun->first)];
      seen[0].assign(plane.begin(), plane.end());
      std::ranges::fill(plane, kAllSeen);
    }
    for (const auto& [id, row] : held_.light_rows.all()) {
      for (std::uint32_t lane = 0; lane < page.count; ++lane) seen[id].push_back(row[page.row(lane)]);
    }
    Blob& blob = blobs_[number];
    if (blob.version != page.version) blob = {.version = page.version, .parts = {}};
    parts = blob.parts;
  }
  std::vector<PagePacket> out;
  if (page.count == 0) return out;
  const PageOptions blob_options{.ids = false, .keep_order = true, .origin = mean_origin(lanes, layout)};
  for (std::uint32_t first = 0; first < page.count; first += part_lanes) {
    const std::uint32_t count = std::min(part_lanes, page.count - first);
    std::shared_ptr<const Bytes>& blob = parts[{first, count}];
    if (!blob) {
      std::vector<std::uint32_t> columns(count);
      std::iota(columns.begin(), columns.end(), first);
      blob =
          std::make_shared<const Bytes>(encode_page(lanes.gather(columns), layout, options_.codec, blob_options).bytes);
      const std::scoped_lock lock(mutex_);
      const auto kept = blobs_.find(number);  // not when the page has ended meanwhile
      if (kept != blobs_.end() && kept->second.version == page.version) kept->second.parts[{first, count}] = blob;
    }
    Bytes payload = *blob;
    std::vector<wire::SeenRow> rows;
    for (const auto& [id, values] : seen) {
      const Bytes part(values.begin() + first, values.begin() + first + count);
      if (all_seen(part)) continue;
      const Bytes packed = zstd_compress(part);
      rows.emplace_back(id, count, static_cast<std::uint32_t>(packed.size()));
      append(payload, packed);
    }
    const auto blob_bytes = static_cast<std::uint32_t>(blob->size());
    out.push_back({writer_.write(
                       epoch, 0, wire::Body::Page,
                       [&](auto& builder) {
                         const auto seen_at = builder.CreateVectorOfStructs(rows);
                         return wire::CreatePage(builder, number, page.version, page.structure, page.count, first,
                                                 count, page.level, page.frozen,
                                                 static_cast<std::uint8_t>(options_.codec), blob_bytes, seen_at);
                       },
                       std::move(payload)),
                   number, page.version, page.structure});
  }
  return out;
}

// In one part, or in all of the blocks that it has.
std::optional<std::size_t> StreamModel::blob_bytes(const OfferedPage& page) const {
  const auto found = blobs_.find(page.page);
  if (found == blobs_.end() || found->second.version != page.version) return std::nullopt;
  const auto& parts = found->second.parts;
  if (const auto whole = parts.find({0, page.count}); whole != parts.end()) return whole->second->size();
  std::size_t bytes = 0;
  for (std::uint32_t first = 0; first < page.count; first += kBlockRows) {
    const auto part = parts.find({first, std::min(kBlockRows, page.count - first)});
    if (part == parts.end()) return std::nullopt;
    bytes += part->second->size();
  }
  return bytes;
}

std::vector<EncodedPacket> StreamModel::manifest_packets(std::span<const OfferedPage> pages,
                                                         std::span<const std::uint32_t> gone, bool whole,
                                                         std::optional<std::size_t> gaussians) const {
  std::vector<EncodedPacket> out;
  const Status now = status();
  std::vector<std::size_t> bytes;
  bytes.reserve(pages.size());
  {
    const std::scoped_lock lock(mutex_);
    for (const OfferedPage& page : pages) {
      bytes.push_back(blob_bytes(page).value_or(static_cast<std::size_t>(page.count * appended_bytes_)));
    }
  }
  std::size_t first = 0;
  do {
    const auto part = pages.subspan(first, std::min(kManifestPages, pages.size() - first));
    std::vector<wire::PageInfo> infos;
    for (const OfferedPage& page : part) {
      const std::size_t all = bytes[first + infos.size()];
      const wire::PageBox box(to_wire(page.bounds.low), to_wire(page.bounds.high), page.bounds.max_scale_m);
      infos.emplace_back(page.page, page.version, page.count, static_cast<std::uint32_t>(all), page.object_id, box,
                         page.level, page.frozen, static_cast<std::uint8_t>(options_.codec));
    }
    first += part.size();
    out.push_back(writer_.write(now.epoch, 0, wire::Body::Manifest, [&](auto& builder) {
      const auto pages_at = builder.CreateVectorOfStructs(infos);
      const auto gone_at = out.empty() ? builder.CreateVector(gone.data(), gone.size()) : 0;
      return wire::CreateManifest(builder, whole && out.empty(), pages_at, gone_at, gaussians.value_or(now.gaussians),
                                  first < pages.size());
    }));
  } while (first < pages.size());
  return out;
}

EncodedPacket StreamModel::gone_packet(std::span<const std::uint32_t> pages) const {
  return brief_writer_.write(status().epoch, 0, wire::Body::PagesGone, [&](auto& builder) {
    return wire::CreatePagesGone(builder, builder.CreateVector(pages.data(), pages.size()));
  });
}

}  // namespace splatbus::stream
