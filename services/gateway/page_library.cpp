#include "gateway/page_library.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <array>
#include <charconv>
#include <nlohmann/json.hpp>

#include "gateway/static_files.h"
#include "stream/bytes.h"

namespace splatbus::gateway {

namespace {

constexpr std::int64_t kAskAgainNs = 500'000'000;
constexpr std::int64_t kForgottenNs = 3'000'000'000;  // nobody waits for it any more
constexpr std::size_t kPagesAPacket = 1000;
constexpr std::string_view kPagePrefix = "/page/";
constexpr std::size_t kEpochDigits = 16;

template <class Number>
bool parse_number(std::string_view text, Number& number, int base) {
  const char* end = text.data() + text.size();
  const auto parsed = std::from_chars(text.data(), end, number, base);
  return !text.empty() && parsed.ec == std::errc() && parsed.ptr == end;
}

/// As stream/packet_log.h has it.
void append_message(std::string& log, const stream::EncodedPacket& packet) {
  for (const std::size_t size : {packet.packet.size(), packet.payload.size()}) {
    for (int i = 0; i < 4; ++i) log += static_cast<char>(size >> (8 * i));
  }
  log.append(packet.packet.begin(), packet.packet.end());
  log.append(packet.payload.begin(), packet.payload.end());
}

nlohmann::json to_json(const wire::Vec3& v) {
  return {v.x(), v.y(), v.z()};
}

wire::PageInfo with_bytes(const wire::PageInfo& info, std::uint32_t bytes) {
  return {info.page(), info.version(), info.count(),  bytes,       info.object_id(),
          info.box(),  info.level(),   info.frozen(), info.codec()};
}

std::span<const std::uint8_t> bytes_of(const zmq::message_t& message) {
  return {static_cast<const std::uint8_t*>(message.data()), message.size()};
}

}  // namespace

std::optional<PageName> parse_page_path(std::string_view path) {
  if (!path.starts_with(kPagePrefix)) return std::nullopt;
  path.remove_prefix(kPagePrefix.size());
  const std::size_t first = path.find('/');
  if (first != kEpochDigits) return std::nullopt;
  const std::size_t second = path.find('/', first + 1);
  if (second == std::string_view::npos) return std::nullopt;
  PageName name;
  const bool parsed = parse_number(path.substr(0, first), name.epoch, 16) &&
                      parse_number(path.substr(first + 1, second - first - 1), name.page, 10) &&
                      parse_number(path.substr(second + 1), name.version, 10);
  // One name, one path: caches tell pages apart by their paths.
  if (!parsed || path_of(name).substr(kPagePrefix.size()) != path) return std::nullopt;
  return name;
}

std::string path_of(const PageName& name) {
  return fmt::format("{}{:016x}/{}/{}", kPagePrefix, name.epoch, name.page, name.version);
}

std::string etag_of(const PageName& name) {
  return fmt::format("\"{:016x}-{}-{}\"", name.epoch, name.page, name.version);
}

PageLibrary::PageLibrary(zmq::context_t& context, const std::string& streamer, std::size_t max_bytes, Traffic& traffic)
    : context_(context), streamer_(streamer), link_(context, streamer), max_bytes_(max_bytes), traffic_(traffic) {}

bool PageLibrary::ask_at(const std::string& streamer) {
  if (streamer == streamer_) return false;
  link_ = StreamLink(context_, streamer);
  streamer_ = streamer;
  manifest_ns_ = manifest_asked_ns_ = 0;
  coming_ = {};
  for (auto& [name, want] : wants_) want.asked_ns = 0;
  return true;
}

bool PageLibrary::knows(const PageName& name) const {
  if (name.epoch != manifest_.epoch) return false;
  const auto found = manifest_.pages.find(name.page);
  return found != manifest_.pages.end() && found->second.version() == name.version && !absent_.contains(name);
}

PageLibrary::Found PageLibrary::page(const PageName& name, std::int64_t now_ns) {
  if (const auto kept = kept_.find(name); kept != kept_.end()) {
    recent_.splice(recent_.begin(), recent_, kept->second);
    wants_.erase(name);
    ++traffic_.pages_served;
    return {.state = State::Here, .body = kept->second->body, .etag = etag_of(name)};
  }
  if (knows(name)) {
    wants_[name].wanted_ns = now_ns;
  } else if (is_fresh(now_ns)) {
    wants_.erase(name);
    return {.state = State::Absent, .body = nullptr, .etag = {}};
  } else {
    want_manifest(now_ns);
  }
  ask(now_ns);
  return {};
}

PageLibrary::Found PageLibrary::manifest(bool json, std::int64_t now_ns) {
  if (is_fresh(now_ns)) return json ? json_ : binary_;
  want_manifest(now_ns);
  ask(now_ns);
  return {};
}

void PageLibrary::want_manifest(std::int64_t now_ns) {
  manifest_wanted_ns_ = now_ns;
}

void PageLibrary::ask(std::int64_t now_ns) {
  std::erase_if(wants_, [&](const auto& want) {
    return now_ns - want.second.wanted_ns > kForgottenNs || want.first.epoch != manifest_.epoch;
  });
  const auto waits = [&](std::int64_t asked_ns) { return asked_ns != 0 && now_ns - asked_ns < kAskAgainNs; };
  std::size_t in_flight = 0;
  for (const auto& [name, want] : wants_) in_flight += waits(want.asked_ns) ? 1 : 0;
  std::vector<PageName> pages;
  for (auto& [name, want] : wants_) {
    if (in_flight >= kInFlight) break;
    if (waits(want.asked_ns)) continue;
    want.asked_ns = now_ns;
    pages.push_back(name);
    ++in_flight;
  }
  const bool wanted = manifest_wanted_ns_ > manifest_ns_ && now_ns - manifest_wanted_ns_ < kForgottenNs;
  const bool manifest = wanted && !waits(manifest_asked_ns_);
  if (manifest) manifest_asked_ns_ = now_ns;
  if (manifest || !pages.empty()) send(manifest, pages);
}

void PageLibrary::send(bool manifest, const std::vector<PageName>& pages) {
  std::vector<wire::PageVersion> names;
  names.reserve(pages.size());
  for (const PageName& name : pages) names.emplace_back(name.page, name.version);
  const auto packet = stream::PacketWriter::brief().write(
      manifest_.epoch, 0, wire::Body::PageRequest,
      [&](auto& builder) { return wire::CreatePageRequest(builder, manifest, builder.CreateVectorOfStructs(names)); });
  // Who may control is a service: it is given as many as it asks for.
  link_.send({.packet = packet.packet, .payload = {}}, bus::Rights{.view = true, .control = true});
}

bool PageLibrary::poll(std::int64_t now_ns) {
  StreamPacket packet;
  bool any = false;
  while (link_.receive(packet)) {
    any = true;
    try {
      take(packet, now_ns);
    } catch (const std::runtime_error& error) {
      spdlog::warn("a page of the streamer: {}", error.what());
    }
    ask(now_ns);
  }
  return any;
}

void PageLibrary::take(const StreamPacket& message, std::int64_t now_ns) {
  const auto packet = stream::ParsedPacket::parse(bytes_of(message.packet), bytes_of(message.payload));
  switch (packet.body()) {
    case wire::Body::Layout:
      return take_layout(packet);
    case wire::Body::Manifest:
      return take_manifest(packet, now_ns);
    case wire::Body::Page:
      return take_page(packet);
    case wire::Body::PagesGone:
      for (const std::uint32_t page : *packet.root().body_as_PagesGone()->pages()) {
        std::erase_if(wants_, [&](const auto& want) {
          if (want.first.page != page || want.second.asked_ns == 0) return false;
          absent_.insert(want.first);
          return true;
        });
      }
      return;
    default:
      return;  // a streamer that has just come back says hello to everybody
  }
}

void PageLibrary::take_layout(const stream::ParsedPacket& packet) {
  const wire::Layout& body = *packet.root().body_as_Layout();
  layout_epoch_ = packet.stream_epoch();
  layout_ = stream::PacketWriter::brief().write(layout_epoch_, 0, wire::Body::Layout, [&](auto& builder) {
    std::vector<flatbuffers::Offset<wire::TensorMetadata>> attributes;
    for (const wire::TensorMetadata* a : *body.attributes()) {
      attributes.push_back(wire::CreateTensorMetadata(builder, a->attribute(), a->channels(), a->quantizer()));
    }
    return wire::CreateLayout(builder, body.appearance(), body.sh_degree(), builder.CreateVector(attributes),
                              body.page_lanes());
  });
}

void PageLibrary::take_manifest(const stream::ParsedPacket& packet, std::int64_t now_ns) {
  const wire::Manifest& body = *packet.root().body_as_Manifest();
  if (body.whole()) coming_ = {.pages = {}, .epoch = packet.stream_epoch(), .gaussians = 0, .begun = true};
  if (!coming_.begun || coming_.epoch != packet.stream_epoch() || coming_.epoch != layout_epoch_) return;
  for (const wire::PageInfo* info : *body.pages()) {
    // For a moment, a page that is asked for is none that rests.
    const auto before = manifest_.epoch == coming_.epoch ? manifest_.pages.find(info->page()) : manifest_.pages.end();
    const bool rested = before != manifest_.pages.end() && before->second.version() == info->version();
    if (!info->frozen() && !rested) continue;
    coming_.pages[info->page()] = rested ? before->second : *info;
    coming_.gaussians += info->count();
  }
  if (!body.more()) publish(std::exchange(coming_, {}), now_ns);
}

void PageLibrary::publish(Manifest manifest, std::int64_t now_ns) {
  manifest_ = std::move(manifest);
  manifest_ns_ = now_ns;
  absent_.clear();
  const auto found = [](std::string text) {
    auto body = std::make_shared<const std::string>(std::move(text));
    std::string etag = gateway::etag_of(*body);
    return Found{.state = State::Here, .body = std::move(body), .etag = std::move(etag)};
  };
  binary_ = found(manifest_packets());
  json_ = found(manifest_json());
}

std::string PageLibrary::manifest_packets() const {
  std::string log;
  append_message(log, layout_);
  auto at = manifest_.pages.begin();
  bool first = true;
  do {
    std::vector<wire::PageInfo> part;
    for (; at != manifest_.pages.end() && part.size() < kPagesAPacket; ++at) part.push_back(at->second);
    append_message(log,
                   stream::PacketWriter::brief().write(manifest_.epoch, 0, wire::Body::Manifest, [&](auto& builder) {
                     return wire::CreateManifest(builder, first, builder.CreateVectorOfStructs(part), 0,
                                                 manifest_.gaussians, at != manifest_.pages.end());
                   }));
    first = false;
  } while (at != manifest_.pages.end());
  return log;
}

std::string PageLibrary::manifest_json() const {
  nlohmann::json pages = nlohmann::json::array();
  for (const auto& [number, info] : manifest_.pages) {
    const wire::PageBox& box = info.box();
    pages.push_back({{"path", path_of({manifest_.epoch, number, info.version()})},
                     {"page", number},
                     {"version", info.version()},
                     {"gaussians", info.count()},
                     {"bytes", info.bytes()},
                     {"level", info.level()},
                     {"object_id", info.object_id()},
                     {"low", to_json(box.low())},
                     {"high", to_json(box.high())},
                     {"max_scale_m", box.max_scale_m()}});
  }
  return nlohmann::json{{"stream_epoch", fmt::format("{:016x}", manifest_.epoch)},
                        {"gaussians", manifest_.gaussians},
                        {"pages", std::move(pages)}}
             .dump() +
         "\n";
}

void PageLibrary::take_page(const stream::ParsedPacket& packet) {
  const wire::Page& body = *packet.root().body_as_Page();
  const PageName name{packet.stream_epoch(), body.page(), body.version()};
  const std::span<const std::uint8_t> payload = packet.payload();
  if (wants_.erase(name) == 0 || body.first() != 0 || body.part() != body.count() ||
      body.blob_bytes() > payload.size()) {
    return;
  }
  const auto blob = payload.first(body.blob_bytes());
  // What it sees of the lights changes, and comes with the stream.
  const auto page = stream::PacketWriter::brief().write(
      name.epoch, 0, wire::Body::Page,
      [&](auto& builder) {
        return wire::CreatePage(builder, name.page, name.version, body.structure(), body.count(), 0, body.count(),
                                body.level(), true, body.codec(), body.blob_bytes());
      },
      {blob.begin(), blob.end()});
  std::string log;
  append_message(log, page);
  keep(name, std::move(log));
  if (const auto named = manifest_.pages.find(name.page);
      named != manifest_.pages.end() && name.epoch == manifest_.epoch && named->second.version() == name.version) {
    named->second = with_bytes(named->second, body.blob_bytes());
  }
}

void PageLibrary::keep(const PageName& name, std::string body) {
  ++traffic_.pages_fetched;
  bytes_ += body.size();
  recent_.push_front({.name = name, .body = std::make_shared<const std::string>(std::move(body))});
  kept_[name] = recent_.begin();
  while (bytes_ > max_bytes_ && recent_.size() > 1) {
    bytes_ -= recent_.back().body->size();
    kept_.erase(recent_.back().name);
    recent_.pop_back();
  }
  traffic_.page_bytes = bytes_;
}

}  // namespace splatbus::gateway
