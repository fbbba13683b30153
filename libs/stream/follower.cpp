#include "stream/follower.h"

#include <fmt/format.h>

#include <algorithm>

#include "stream/bytes.h"
#include "wire/convert.h"
#include "wire/picture_size.h"

namespace splatbus::stream {

namespace {

constexpr std::int64_t kHeldEveryNs = 250'000'000, kUrgentNs = 50'000'000;
constexpr std::uint64_t kMuchBytes = std::uint64_t{1} << 15;  // since it last said what it holds
constexpr std::size_t kMaxHelloPages = 6000;                  // of a message that may have 64 KiB
constexpr std::size_t kMaxHeldItems = 1000;
constexpr std::int64_t kRests = 10;

bool is_due(const std::optional<std::int64_t>& last_ns, std::int64_t every_ns, std::int64_t now_ns) {
  return !last_ns || now_ns - *last_ns >= every_ns;
}

/// A wall of screens is told as the same view in fewer pixels: a streamer takes no more.
wire::Camera told(Camera camera) {
  const std::uint32_t longest = std::max(camera.width, camera.height);
  if (longest > kMaxPictureSide) {
    const float scale = static_cast<float>(kMaxPictureSide) / static_cast<float>(longest);
    for (std::uint32_t* side : {&camera.width, &camera.height}) {
      *side = std::clamp(static_cast<std::uint32_t>(scale * static_cast<float>(*side)), 1U, kMaxPictureSide);
    }
    for (float* pixels : {&camera.fx, &camera.fy, &camera.cx, &camera.cy}) *pixels *= scale;
  }
  return to_wire(camera);
}

}  // namespace

Follower::Follower(FollowerOptions options, std::int64_t now_ns)
    : options_(std::move(options)),
      writer_(options_.name, std::max<std::uint64_t>(1, static_cast<std::uint64_t>(now_ns))),
      replica_(options_.max_gaussians),
      heard_ns_(now_ns),
      said_ns_(now_ns) {}

bool Follower::receive(std::span<const std::uint8_t> packet, std::span<const std::uint8_t> payload,
                       std::int64_t now_ns) {
  received_bytes_ += packet.size() + payload.size();
  heard_ns_ = now_ns;
  try {
    return take(ParsedPacket::parse(packet, payload), now_ns);
  } catch (const std::runtime_error&) {
    ++refused_;
    throw;
  }
}

bool Follower::take(const ParsedPacket& packet, std::int64_t now_ns) {
  switch (packet.body()) {
    case wire::Body::Welcome:
      // One that asks is followed by a Hello when maintain() next runs, but not once for each that comes.
      welcomed_ = !packet.root().body_as_Welcome()->asks();
      return replica_.receive(packet);
    case wire::Body::ProbePicture:
      take_probe_picture(packet, now_ns);
      return false;
    case wire::Body::Bye: {
      const auto* reason = packet.root().body_as_Bye()->reason();
      notice_ = fmt::format("the streamer says: {}", reason ? reason->string_view() : "");
      return false;
    }
    default:
      break;
  }
  const std::uint64_t version = replica_.scene_version();
  const bool changed = replica_.receive(packet);
  if (const std::int64_t captured_ns = replica_.scene_instant().capture_ns;
      version != 0 && replica_.scene_version() != version && captured_ns != 0) {
    scene_delays_.add((static_cast<double>(now_ns) - static_cast<double>(captured_ns)) / 1e6);  // it may be any number
  }
  return changed;
}

void Follower::take_probe_picture(const ParsedPacket& packet, std::int64_t now_ns) {
  if (!options_.probes && !options_.own_probes) return;
  const wire::ProbePicture& body = *packet.root().body_as_ProbePicture();
  ProbeAnswer answer{.probe_id = body.probe_id(),
                     .camera = from_wire(*body.camera()),
                     .scene = {.light = from_wire(*body.light()),
                               .objects = from_wire(body.objects()),
                               .version = body.scene_version()},
                     .capture_ns = packet.capture_ns(),
                     .arrived_ns = now_ns,
                     .rgba = {}};
  const std::size_t bytes = std::size_t{answer.camera.width} * answer.camera.height * 4;
  if (!is_probe_size(answer.camera.width, answer.camera.height) || body.raw_bytes() != bytes) {
    throw StreamError(fmt::format("ProbePicture: {} bytes for {} x {} pixels", body.raw_bytes(), answer.camera.width,
                                  answer.camera.height));
  }
  if (answer_bytes_ + bytes > options_.held_picture_bytes) {
    notice_ = "probe pictures come faster than they are compared: one is left out";
    return;
  }
  answer.rgba = zstd_decompress(packet.payload(), bytes, "ProbePicture");
  answer_bytes_ += bytes;
  answers_.push_back(std::move(answer));
}

std::optional<ProbeAnswer> Follower::take_probe_answer() {
  if (answers_.empty()) return std::nullopt;
  ProbeAnswer answer = std::move(answers_.front());
  answers_.pop_front();
  answer_bytes_ -= answer.rgba.size();
  return answer;
}

std::optional<EncodedPacket> Follower::next_outgoing(std::int64_t now_ns) {
  if (outgoing_.empty()) maintain(now_ns);
  if (outgoing_.empty()) return std::nullopt;
  EncodedPacket packet = std::move(outgoing_.front());
  outgoing_.pop_front();
  return packet;
}

EncodedPacket Follower::farewell() const {
  return packet_of(wire::Body::Bye, [](auto& builder) { return wire::CreateByeDirect(builder, "the viewer ends"); });
}

void Follower::restart() {
  welcomed_ = false;
  hello_ns_.reset();
  outgoing_.clear();
}

void Follower::hello(std::int64_t now_ns) {
  hello_ns_ = now_ns;
  std::vector<wire::PageVersion> held;
  for (const auto& [page, version] : replica_.held_pages()) {
    if (held.size() < kMaxHelloPages) held.emplace_back(page, version);
  }
  // Of those that are held in part only their number is said: one that has ended meanwhile is to be told as gone.
  for (const auto& [page, state] : replica_.held().pages) {
    if (!state.whole() && held.size() < kMaxHelloPages) held.emplace_back(page, 0);
  }
  say(wire::Body::Hello, [&](auto& builder) {
    const wire::Camera camera = camera_ ? told(*camera_) : wire::Camera();
    return wire::CreateHelloDirect(builder, options_.name.c_str(), camera_ ? &camera : nullptr, options_.probes,
                                   static_cast<std::uint32_t>(options_.max_gaussians), &held,
                                   replica_.visibility_version(), replica_.scene_version(), options_.max_kbps);
  });
}

void Follower::pose(std::int64_t now_ns) {
  const std::int64_t every_ns = options_.pose_every_ns * (posed_ == camera_ ? kRests : 1);
  if (!pose_is_new_ || !is_due(posed_ns_, every_ns, now_ns)) return;
  pose_is_new_ = false;
  posed_ = camera_;
  posed_ns_ = now_ns;
  say(wire::Body::Pose, [&](auto& builder) {
    const wire::Camera wired = told(*camera_);
    return wire::CreatePose(builder, &wired);
  });
}

void Follower::maintain(std::int64_t now_ns) {
  if (welcomed_ && now_ns - heard_ns_ > options_.silence_ns) welcomed_ = false;
  if (!welcomed_) {
    if (is_due(hello_ns_, options_.hello_every_ns, now_ns)) hello(now_ns);
    return;
  }
  pose(now_ns);
  const bool soon = replica_.report().urgent() || received_bytes_ - said_bytes_ >= kMuchBytes;
  const std::int64_t every_ns = soon ? kUrgentNs : kHeldEveryNs;
  if (now_ns - said_ns_ >= every_ns && received_bytes_ != said_bytes_) say_held(now_ns);
}

void Follower::say_held(std::int64_t now_ns) {
  const Replica::Report& report = replica_.report();
  std::vector<wire::SequenceRange> missing;
  std::vector<wire::PageVersion> lacks;
  for (const auto& [first, last] : report.missing) {
    lost_ += last - first + 1;
    if (missing.size() < kMaxHeldItems) missing.emplace_back(first, last);
  }
  for (const auto& [page, version] : report.lacks) {
    if (lacks.size() < kMaxHeldItems) lacks.emplace_back(page, version);
  }
  std::vector<std::uint32_t> dropped = report.dropped;
  if (dropped.size() > kMaxHeldItems) dropped.resize(kMaxHeldItems);
  lacked_ += lacks.size();
  say(wire::Body::Held, [&](auto& builder) {
    return wire::CreateHeldDirect(builder, report.newest, &missing, received_bytes_ - said_bytes_,
                                  static_cast<std::uint32_t>((now_ns - said_ns_) / 1000), &lacks, &dropped,
                                  report.scene_lost, static_cast<std::uint32_t>(replica_.count()), options_.max_kbps);
  });
  replica_.clear_report();
  said_ns_ = now_ns;
  said_bytes_ = received_bytes_;
}

}  // namespace splatbus::stream
