#include "streamer/share_message.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "wire/convert.h"

namespace splatbus::streamer {

namespace {

using stream::StreamError;

constexpr std::size_t kMaxCameras = 16;
constexpr std::size_t kMaxPackets = 8192;

[[noreturn]] void refuse(const std::string& what) {
  throw StreamError("stream/share: " + what);
}

math::Vec3 point(const wire::Vec3& v) {
  return {v.x(), v.y(), v.z()};
}

// A page whose Gaussians are all of no number has no bounds; so has one whose bounds are none.
PageBounds bounds_of(const wire::PageBox& box) {
  const PageBounds bounds{point(box.low()), point(box.high()), box.max_scale_m()};
  const auto ordered = [](float low, float high) { return std::isfinite(low) && std::isfinite(high) && low <= high; };
  const bool sound = ordered(bounds.low.x, bounds.high.x) && ordered(bounds.low.y, bounds.high.y) &&
                     ordered(bounds.low.z, bounds.high.z) && ordered(0, bounds.max_scale_m);
  return sound ? bounds : PageBounds{};
}

// What is asked of a page, such as whose it is, is remembered by its number.
bool is_page(std::uint32_t number) {
  return number < stream::kMaxPageNumber;
}

void require_page(std::uint32_t number) {
  if (!is_page(number)) refuse(fmt::format("page {}", number));
}

/// Whether there is a place for the number that each viewer has for it.
bool has_sequence(const wire::Packet& packet) {
  return reinterpret_cast<const flatbuffers::Table*>(packet.header())->CheckField(wire::Header::VT_SEQUENCE);
}

/// The same for the scene's version, which is written anew.
bool has_scene_version(const wire::LightVisibility& visibility) {
  return reinterpret_cast<const flatbuffers::Table*>(&visibility)->CheckField(wire::LightVisibility::VT_SCENE_VERSION);
}

/// Whether stream::mean_step_for() can say so.
bool is_mean_step(float step) {
  int exponent = 0;
  return step >= 0x1p-20F && step <= 1 && std::frexp(step, &exponent) == 0.5F;
}

std::vector<stream::OfferedPage> read_pages(const wire::StreamShare& body) {
  std::vector<stream::OfferedPage> pages;
  const std::size_t count = body.pages() ? body.pages()->size() : 0;
  if (count > kMaxSharePages) refuse(fmt::format("{} pages", count));
  for (std::size_t k = 0; k < count; ++k) {
    const wire::SharePage& page = *body.pages()->Get(static_cast<flatbuffers::uoffset_t>(k));
    const bool ascends = pages.empty() || pages.back().page < page.page();
    const bool sound = page.count() > 0 && page.count() <= kPageLanes && page.version() > 0 &&
                       page.version() <= body.version() && page.structure() <= page.version();
    if (!ascends || !sound || !is_page(page.page())) {
      refuse(fmt::format("page {} at {} of {} Gaussians", page.page(), page.version(), page.count()));
    }
    pages.push_back({.page = page.page(),
                     .version = page.version(),
                     .structure = page.structure(),
                     .count = page.count(),
                     .object_id = page.object_id(),
                     .level = page.level(),
                     .frozen = page.frozen(),
                     .bounds = bounds_of(page.box())});
  }
  return pages;
}

ShareMessage::Viewers read_viewers(const wire::StreamShare& body) {
  ShareMessage::Viewers viewers{
      .followed = body.followed(), .bytes_per_s = body.bytes_per_s(), .held = {}, .cameras = {}};
  if (!std::isfinite(viewers.bytes_per_s) || viewers.bytes_per_s < 0) refuse("no rate");
  if (body.held()) {
    if (body.held()->size() > kMaxSharePages) refuse(fmt::format("{} pages held", body.held()->size()));
    for (const std::uint32_t page : *body.held()) require_page(page);
    viewers.held = {body.held()->begin(), body.held()->end()};
  }
  if (body.cameras()) {
    if (body.cameras()->size() > kMaxCameras) refuse(fmt::format("{} cameras", body.cameras()->size()));
    for (const wire::Camera* camera : *body.cameras()) viewers.cameras.push_back(from_wire(*camera));
  }
  return viewers;
}

stream::DeltaPacket read_delta(const wire::PageDelta& delta, const wire::SharePacket& wired,
                               stream::EncodedPacket packet, std::uint32_t newest) {
  stream::DeltaPacket out{.packet = std::move(packet), .steps = {}, .gone = {}};
  const std::size_t count = delta.steps()->size(), said = wired.steps() ? wired.steps()->size() : 0;
  if (count != said || count > stream::kMaxDeltaPages) refuse(fmt::format("{} steps and {} figures", count, said));
  for (std::size_t k = 0; k < count; ++k) {
    const wire::PageStep& step = *delta.steps()->Get(static_cast<flatbuffers::uoffset_t>(k));
    const float steps = wired.steps()->Get(static_cast<flatbuffers::uoffset_t>(k));
    const bool sound = is_page(step.page()) && is_page(step.base()) && step.removed() <= step.count() &&
                       step.count() <= kPageLanes && step.appended() <= kPageLanes &&
                       step.from_version() < step.version() && step.version() <= newest && std::isfinite(steps) &&
                       steps >= 0;
    if (!sound) refuse(fmt::format("a step of page {}", step.page()));
    out.steps.push_back({.page = step.page(),
                         .base = step.base(),
                         .from_version = step.from_version(),
                         .version = step.version(),
                         .count = step.count() - step.removed() + step.appended(),
                         .other_lanes = step.base() != step.page() || step.removed() > 0 || step.appended() > 0,
                         .steps = steps});
  }
  if (delta.gone()) {
    if (delta.gone()->size() > stream::kMaxDeltaPages) refuse("more pages end than are allowed");
    for (const wire::PageVersion* page : *delta.gone()) {
      require_page(page->page());
      out.gone.push_back({page->page(), page->version()});
    }
  }
  return out;
}

std::vector<wire::SeenPage> seen_pages(const wire::LightVisibility& visibility) {
  if (visibility.pages()->size() > stream::kMaxDeltaPages) refuse("visibility of more pages than are allowed");
  std::vector<wire::SeenPage> pages;
  for (const wire::SeenPage* page : *visibility.pages()) {
    require_page(page->page());
    pages.push_back(*page);
  }
  return pages;
}

/// Puts packets that belong together into one answer each.
class Answers {
 public:
  explicit Answers(std::uint32_t newest) : newest_(newest) {}

  void add(const wire::Page& page, stream::EncodedPacket packet) {
    require_page(page.page());
    const bool begins = page.first() == 0;
    if (begins) begin({page.page(), page.part() == page.count() ? wire::SharePart::Whole : wire::SharePart::Parts});
    ShareAnswer* answer = open_;
    const bool fits = answer && page.page() == answer->what.page && page.first() == lanes_ && page.part() > 0 &&
                      page.part() <= page.count() - std::min(page.first(), page.count()) &&
                      (begins || (page.version() == answer->version && page.count() == count_));
    if (!fits || page.count() > kPageLanes || page.version() > newest_)
      refuse(fmt::format("a part of page {}", page.page()));
    answer->version = page.version();
    answer->structure = page.structure();
    answer->packets.push_back(std::move(packet));
    count_ = page.count();
    lanes_ = page.first() + page.part();
    whole_ = lanes_ == count_;
  }
  void add(const wire::LightVisibility& visibility, stream::EncodedPacket packet) {
    if (visibility.pages()->size() != 1) refuse("visibility of one page was wanted");
    require_page(visibility.pages()->Get(0)->page());
    const ShareWant what{visibility.pages()->Get(0)->page(), wire::SharePart::Visibility};
    if (!open_ || open_->what != what) begin(what);
    open_->structure = visibility.pages()->Get(0)->structure();
    open_->packets.push_back(std::move(packet));
  }
  std::vector<ShareAnswer> take() {
    if (!whole_) refuse("half a page");
    return std::move(all_);
  }

 private:
  void begin(const ShareWant& what) {
    if (!whole_) refuse("half a page");
    open_ = &all_.emplace_back(ShareAnswer{.what = what, .packets = {}});
    lanes_ = 0;
  }

  std::uint32_t newest_;
  std::vector<ShareAnswer> all_;
  ShareAnswer* open_ = nullptr;
  std::uint32_t lanes_ = 0, count_ = 0;
  bool whole_ = true;
};

void read_packets(const wire::StreamShare& body, ShareMessage& message) {
  if (!body.packets()) return;
  if (body.packets()->size() > kMaxPackets) refuse(fmt::format("{} packets", body.packets()->size()));
  Answers answers(body.version());
  for (const wire::SharePacket* wired : *body.packets()) {
    const std::span<const std::uint8_t> bytes(wired->packet()->data(), wired->packet()->size());
    std::span<const std::uint8_t> payload;
    if (wired->payload()) payload = {wired->payload()->data(), wired->payload()->size()};
    const auto parsed = stream::ParsedPacket::parse(bytes, payload);
    if (parsed.stream_epoch() != body.stream_epoch()) refuse("a packet of another epoch");
    if (!has_sequence(parsed.root())) refuse("a packet without a number to write");
    stream::EncodedPacket packet{.body = parsed.body(),
                                 .sequence = 0,
                                 .packet = {bytes.begin(), bytes.end()},
                                 .payload = {payload.begin(), payload.end()}};
    const wire::Packet& root = parsed.root();
    if (const auto* seen = root.body_as_LightVisibility(); seen && !has_scene_version(*seen)) {
      refuse("visibility without a scene's version to write");
    }
    if (const auto* delta = root.body_as_PageDelta()) {
      message.deltas.push_back(read_delta(*delta, *wired, std::move(packet), body.version()));
    } else if (const auto* page = root.body_as_Page()) {
      answers.add(*page, std::move(packet));
    } else if (const auto* visibility = root.body_as_LightVisibility(); visibility && wired->answer()) {
      answers.add(*visibility, std::move(packet));
    } else if (visibility) {
      message.visibility.push_back({std::move(packet), seen_pages(*visibility)});
    } else {
      refuse(fmt::format("a {} is not shared", wire::EnumNameBody(parsed.body())));
    }
  }
  message.answers = answers.take();
}

}  // namespace

ShareMessage read_share(const wire::StreamShare& body) {
  ShareMessage message;
  const bool transfer = body.appearance() == wire::Appearance::Transfer;
  if (body.appearance() > wire::Appearance::MAX || body.sh_degree() > 3) refuse("an unknown layout");
  if (body.stream_epoch() != 0 && !is_mean_step(body.mean_step())) refuse("an invalid step of means");
  if (body.version() >= kVersionBlocks * kVersionBlock) refuse(fmt::format("version {}", body.version()));
  message.place = {.epoch = body.stream_epoch(),
                   .layout = stream::StreamLayout({.appearance = transfer ? Appearance::Transfer : Appearance::Radiance,
                                                   .sh_degree = body.sh_degree()},
                                                  1)
                                 .parameters(),
                   .mean_step = body.mean_step(),
                   .version = body.version(),
                   .encodes = body.encodes() && body.stream_epoch() != 0};
  if (body.ticked()) message.viewers = read_viewers(body);
  if (body.has_pages()) message.pages = read_pages(body);
  read_packets(body, message);
  if (body.wants()) {
    if (body.wants()->size() > kMaxShareWants) refuse(fmt::format("{} wants", body.wants()->size()));
    for (const wire::ShareWant* want : *body.wants()) {
      if (want->part() > wire::SharePart::MAX) refuse("an unknown part");
      require_page(want->page());
      message.wants.push_back({want->page(), want->part()});
    }
  }
  return message;
}

std::size_t answer_bytes(const ShareAnswer& answer) {
  std::size_t bytes = 0;
  for (const stream::EncodedPacket& packet : answer.packets) bytes += packet.bytes();
  return bytes;
}

flatbuffers::Offset<wire::StreamShare> write_share(flatbuffers::FlatBufferBuilder& builder,
                                                   flatbuffers::Offset<wire::Header> header,
                                                   const ShareMessage& message) {
  std::vector<flatbuffers::Offset<wire::SharePacket>> packets;
  const auto add = [&](const stream::EncodedPacket& packet, bool answer, const std::vector<float>* steps = nullptr) {
    const auto bytes_at = builder.CreateVector(packet.packet), payload_at = builder.CreateVector(packet.payload);
    const auto steps_at = steps ? builder.CreateVector(*steps) : 0;
    packets.push_back(wire::CreateSharePacket(builder, bytes_at, payload_at, steps_at, answer));
  };
  for (const stream::DeltaPacket& delta : message.deltas) {
    std::vector<float> steps;
    for (const stream::DeltaPacket::Step& step : delta.steps) steps.push_back(step.steps);
    add(delta.packet, false, &steps);
  }
  for (const stream::VisibilityPacket& visibility : message.visibility) add(visibility.packet, false);
  for (const ShareAnswer& answer : message.answers) {
    for (const stream::EncodedPacket& packet : answer.packets) add(packet, true);
  }
  std::vector<wire::SharePage> pages;
  for (const stream::OfferedPage& page : message.pages.value_or(std::vector<stream::OfferedPage>{})) {
    const math::Vec3 &low = page.bounds.low, &high = page.bounds.high;
    const wire::PageBox box({low.x, low.y, low.z}, {high.x, high.y, high.z}, page.bounds.max_scale_m);
    pages.emplace_back(page.page, page.version, page.structure, page.count, page.object_id, box, page.level,
                       page.frozen);
  }
  std::vector<wire::ShareWant> wants;
  for (const ShareWant& want : message.wants) wants.emplace_back(want.page, want.part);
  const ShareMessage::Viewers viewers = message.viewers.value_or(ShareMessage::Viewers{});
  std::vector<wire::Camera> cameras;
  for (const Camera& camera : viewers.cameras) cameras.push_back(to_wire(camera));
  const std::vector<std::uint32_t> held(viewers.held.begin(), viewers.held.end());

  const auto held_at = builder.CreateVector(held);
  const auto cameras_at = builder.CreateVectorOfStructs(cameras);
  const auto pages_at = builder.CreateVectorOfStructs(pages);
  const auto packets_at = builder.CreateVector(packets);
  const auto wants_at = builder.CreateVectorOfStructs(wants);
  const bool transfer = message.place.layout.appearance == Appearance::Transfer;
  return wire::CreateStreamShare(
      builder, header, message.place.epoch, transfer ? wire::Appearance::Transfer : wire::Appearance::Radiance,
      static_cast<std::uint8_t>(transfer ? 0 : message.place.layout.sh_degree), message.place.mean_step,
      message.place.encodes, message.viewers.has_value(), message.place.version, viewers.followed, viewers.bytes_per_s,
      held_at, cameras_at, message.pages.has_value(), pages_at, packets_at, wants_at);
}

}  // namespace splatbus::streamer
