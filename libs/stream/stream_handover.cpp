#include "stream/stream_handover.h"

#include <fmt/format.h>

#include <algorithm>
#include <cassert>
#include <unordered_set>
#include <utility>

#include "stream/pieces.h"
#include "stream/stream_model.h"

namespace splatbus::stream {

namespace {

constexpr std::size_t kMaxTables = kMaxPageNumber + 1;

ParsedPacket parse(const flatbuffers::Vector<std::uint8_t>& packet, std::span<const std::uint8_t> payload,
                   std::uint64_t epoch, wire::Body body) {
  ParsedPacket parsed = ParsedPacket::parse({packet.data(), packet.size()}, payload);
  if (parsed.body() != body || parsed.stream_epoch() != epoch) {
    throw StreamError(fmt::format("handover: its {} is a {} of epoch {}", wire::EnumNameBody(body),
                                  wire::EnumNameBody(parsed.body()), parsed.stream_epoch()));
  }
  return parsed;
}

void take_page(ReplicatedState& state, const wire::HandedPage& page, std::uint64_t epoch,
               std::unordered_set<std::uint64_t>& ids) {
  const auto& payload = *page.payload();
  const ParsedPacket packet = parse(*page.packet(), {payload.data(), payload.size()}, epoch, wire::Body::Page);
  const std::uint32_t number = packet.root().body_as_Page()->page();
  if (state.find(number)) throw StreamError(fmt::format("handover: page {} comes twice", number));
  (void)apply(state, packet);
  const HeldPage* const held = state.find(number);
  if (!held || !held->whole()) throw StreamError(fmt::format("handover: page {} is not whole", number));
  const auto& gaussian_ids = *page.gaussian_ids();
  if (gaussian_ids.size() != held->count) {
    throw StreamError(
        fmt::format("handover: page {} has {} Gaussians and {} ids", number, held->count, gaussian_ids.size()));
  }
  for (std::uint32_t lane = 0; lane < held->count; ++lane) {
    const std::uint64_t id = gaussian_ids[lane];
    if (id == 0) throw StreamError(fmt::format("handover: page {}: a Gaussian without an id", number));
    // One that a publisher repeated: the first counts, and of the other nothing is known, so that it goes.
    if (ids.insert(id).second) state.gaussians.gaussian_id.set(held->row(lane), id);
  }
}

auto to_vector(flatbuffers::FlatBufferBuilder& builder, const Bytes& bytes) {
  return builder.CreateVector(bytes.data(), bytes.size());
}

}  // namespace

StreamHandover read_handover(std::span<const std::uint8_t> bytes) {
  flatbuffers::Verifier verifier(bytes.data(), bytes.size(), 8, kMaxTables);
  if (!verifier.VerifyBuffer<wire::StreamHandover>(nullptr)) throw StreamError("handover: it does not verify");
  const auto& root = *flatbuffers::GetRoot<wire::StreamHandover>(bytes.data());
  const std::uint64_t epoch = root.stream_epoch();
  if (epoch == 0) throw StreamError("handover: no stream epoch");
  StreamHandover out;
  ReplicatedState& state = out.held;
  state.epoch = epoch;
  state.layout = StreamLayout::from_wire(*parse(*root.layout(), {}, epoch, wire::Body::Layout).root().body_as_Layout());
  state.gaussians = HeldGaussians(state.layout);
  if (root.scene()) (void)apply(state, parse(*root.scene(), {}, epoch, wire::Body::Scene));
  std::unordered_set<std::uint64_t> ids;
  for (const wire::HandedPage* page : *root.pages()) take_page(state, *page, epoch, ids);
  state.visibility_version = root.visibility_version();
  out.version = root.version();
  for (const auto& [number, page] : state.pages) {
    if (page.version <= out.version && page.structure <= page.version) continue;
    throw StreamError(fmt::format("handover: page {} is newer than the newest", number));
  }
  return out;
}

Bytes StreamModel::hand_over() {
  assert(ready_);
  std::vector<std::uint32_t> numbers;
  for (const auto& [number, held] : held_.pages) numbers.push_back(number);
  std::vector<std::vector<PagePacket>> packets(numbers.size());
  for_each_at_once(numbers.size(), [&](std::size_t k) { packets[k] = page_packets(numbers[k], kPageLanes, false); });
  flatbuffers::FlatBufferBuilder builder(std::size_t{1} << 20U);
  std::vector<flatbuffers::Offset<wire::HandedPage>> pages;
  for (std::size_t k = 0; k < numbers.size(); ++k) {
    const HeldPage& held = *held_.find(numbers[k]);
    std::vector<std::uint64_t> ids;
    for (std::uint32_t lane = 0; lane < held.count; ++lane) {
      ids.push_back(held_.gaussians.gaussian_id[held.row(lane)]);
    }
    for (const PagePacket& whole : packets[k]) {
      const auto packet_at = to_vector(builder, whole.packet.packet);
      const auto payload_at = to_vector(builder, whole.packet.payload);
      pages.push_back(wire::CreateHandedPage(builder, packet_at, payload_at, builder.CreateVector(ids)));
    }
  }
  const auto layout_at = to_vector(builder, layout_packet().packet);
  const std::optional<EncodedPacket> scene = scene_packet();
  const auto scene_at = scene ? to_vector(builder, scene->packet) : 0;
  const auto pages_at = builder.CreateVector(pages);
  builder.Finish(wire::CreateStreamHandover(builder, held_.epoch, version_, held_.visibility_version, layout_at,
                                            scene_at, pages_at));
  return {builder.GetBufferPointer(), builder.GetBufferPointer() + builder.GetSize()};
}

void StreamModel::resume(StreamHandover handover) {
  assert(!observed());
  {
    const std::scoped_lock lock(mutex_);
    held_ = std::move(handover.held);
    version_ = handover.version;
    scene_ = held_.quantized_scene;
    instant_ = held_.instant;
  }
  target_layout_ = held_.layout;
  target_ = QuantizedGaussians(held_.layout);
  selection_ = DeltaSelection(held_.layout, options_.schedules, options_.calm_ticks, options_.coarseness);
  precision_ = Precision(held_.layout, options_.coarseness);
  selection_.resize(held_.rows());
  for (const auto& [number, page] : held_.pages) {
    for (std::uint32_t lane = 0; lane < page.count; ++lane) {
      const std::uint32_t row = page.row(lane);
      if (held_.gaussians.gaussian_id[row] != 0) row_of_id_[held_.gaussians.gaussian_id[row]] = row;
      selection_.begin(row, held_.gaussians);
    }
  }
  offer_held();
  set_ready(true);
}

void StreamModel::offer_held() {
  auto offered = std::make_shared<std::vector<OfferedPage>>();
  const std::scoped_lock lock(mutex_);
  for (const auto& [number, page] : held_.pages) {
    const QuantizedGaussians lanes = held_.lanes(page);
    offered->push_back({.page = number,
                        .version = page.version,
                        .structure = page.structure,
                        .count = page.count,
                        .object_id = lanes.object_id.front(),
                        .level = page.level,
                        .frozen = page.frozen,
                        .bounds = bounds_of(lanes, held_.layout, 0, page.count),
                        .surfels = std::make_shared<const PageSurfels>(surfels_of(held_, page))});
  }
  offered_ = std::move(offered);
  offered_epoch_ = held_.epoch;
}

}  // namespace splatbus::stream
