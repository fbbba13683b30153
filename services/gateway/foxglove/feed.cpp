#include "gateway/foxglove/feed.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <array>
#include <thread>
#include <utility>
#include <zmq.hpp>

#include "bus/clock.h"
#include "bus/frames.h"
#include "bus/service.h"
#include "gateway/foxglove/convert.h"
#include "gateway/foxglove/point_sample.h"
#include "wire/capture_generated.h"
#include "wire/engine_generated.h"
#include "wire/scene_generated.h"
#include "wire/schemas.h"
#include "wire/system_generated.h"
#include "wire/viewer_generated.h"

namespace splatbus::gateway::foxglove {

namespace {

constexpr std::size_t kMaxSources = 96, kMaxHeld = 128, kMessagesATurn = 256, kMaxText = 4096;
constexpr std::int64_t kTurnNs = 50'000'000, kTimeEveryNs = 100'000'000;
constexpr std::chrono::milliseconds kConnect(2000);
/// Read while anybody is there: what there is to subscribe to, and parameters.
constexpr std::array kAlways{topics::kTopics.name, topics::kHeartbeat.name, topics::kLiveness.name, topics::kLog.name,
                             topics::kEngineCameras.name};

std::optional<std::string> latch_key(const bus::Message& message) {
  if (!message.header().latch()) return std::nullopt;
  return message.header().latch_key() != nullptr ? message.header().latch_key()->str() : std::string();
}

/// Who stands by is what it succeeds from its takeover on, and nobody's to set before.
bool is_successor(const std::string& source) {
  return source.ends_with(bus::successor_name(""));
}

/// Topics of the bus that a channel is made of; none for one that is a topic itself, or made of the model.
std::set<std::string> sources_of(const std::string& channel) {
  const auto names = [](auto... topics) { return std::set<std::string>{std::string(topics.name)...}; };
  if (channel == kTransforms) return names(topics::kSceneState, topics::kViewerPose);
  if (channel == kViewers) return names(topics::kViewerPose);
  if (channel.starts_with("foxglove/probe/")) return names(topics::kCaptureProbe);
  if (!channel.starts_with("foxglove/")) return {channel};
  const bool pictured = channel.ends_with("/picture") || channel.ends_with("/depth");
  return pictured ? names(topics::kCaptureReference) : std::set<std::string>();
}

Offer offer(std::string_view topic, std::string_view table) {
  const auto schema = wire::foxglove_schema(table);
  return {.topic = std::string(topic), .schema_name = std::string(schema.table), .schema = schema.binary};
}

std::vector<Offer> fixed_offers() {
  return {offer(kTransforms, "foxglove.FrameTransforms"),
          offer(kPoints, "foxglove.PointCloud"),
          offer(kLog, "foxglove.Log"),
          offer(kViewers, "foxglove.CameraCalibration"),
          offer(kProbeCalibration, "foxglove.CameraCalibration"),
          offer(kProbePicture, "foxglove.CompressedImage"),
          offer(kProbeDepth, "foxglove.RawImage")};
}

}  // namespace

Feed::Feed(std::shared_ptr<bus::Context> context, Hub& hub, const Options& options)
    : context_(std::move(context)), hub_(hub), options_(options), publisher_(context_) {
  hub_.offer(Hub::Kind::Fixed, fixed_offers());
  hub_.on_set([this](const std::string& source, const NamedValues& changes) {
    const std::string topic = "control/" + source;
    publisher_.publish(topics::control(topic), [&](auto& builder, auto header) {
      std::vector<flatbuffers::Offset<wire::KeyValue>> pairs;
      for (const auto& [key, value] : changes) {
        pairs.push_back(wire::CreateKeyValueDirect(builder, key.c_str(), value.c_str()));
      }
      return wire::CreateControlDirect(builder, header, &pairs);
    });
  });
}

void Feed::run(const std::stop_token& stop) {
  while (!stop.stop_requested() && hub_.wait_for_client(stop)) {
    try {
      if (serve()) continue;
      sources_.clear();
      wanted_.clear();
      numbers_.clear();
      scene_.reset();
      hub_.forget();
    } catch (const std::exception& error) {
      if (log_limiter_.allow()) spdlog::error("foxglove: {}", error.what());
      std::this_thread::sleep_for(std::chrono::nanoseconds(kTurnNs));
    }
  }
}

bool Feed::serve() {
  if (!sources_.empty()) wait();
  // After the wait: what somebody causes who has just subscribed to it may be what has ended it.
  const auto wanted = hub_.wanted();
  if (!wanted) return false;
  arrange(*wanted);
  for (auto& [topic, source] : sources_) receive(source);
  const std::int64_t now = bus::now_ns();
  if (wanted_.contains(std::string(kPoints))) send_points(now);
  if (now >= next_time_ns_) {
    next_time_ns_ = now + kTimeEveryNs;
    hub_.tell_time(utc(now));
  }
  hub_.expire(now);
  return true;
}

void Feed::arrange(const Hub::Wanted& wanted) {
  std::set<std::string> needed;
  for (const std::string_view topic : kAlways) needed.emplace(topic);
  for (const auto& [channel, number] : wanted) needed.merge(sources_of(channel));
  std::erase_if(sources_, [&](const auto& source) { return !needed.contains(source.first); });
  for (const std::string& topic : needed) {
    if (sources_.contains(topic)) continue;
    if (sources_.size() >= kMaxSources) break;
    const auto made = sources_.emplace(topic, Source{bus::Subscriber(context_, {topic}), {}}).first;
    // A service's refusal must not be missed, and nothing can be set before its heartbeat has been heard.
    if (topic == topics::kLog.name) (void)made->second.subscriber.wait_connected(kConnect);
  }
  if (wanted.contains(std::string(kPoints)) != scene_.has_value()) {
    if (scene_)
      scene_.reset();
    else
      scene_.emplace(context_);
  }
  Channels fresh;
  wanted_.clear();
  for (const auto& [channel, number] : wanted) {
    wanted_.insert(channel);
    const auto before = numbers_.find(channel);
    if (before == numbers_.end() || before->second != number) fresh.insert(channel);
  }
  numbers_ = wanted;
  if (fresh.empty()) return;
  if (fresh.contains(std::string(kTransforms))) {
    hub_.deliver(std::string(kTransforms), utc(bus::now_ns()), frame_transforms({world_in_map()}, utc(bus::now_ns())),
                 std::string(kMap));
  }
  for (const auto& [topic, source] : sources_) {
    for (const auto& [key, message] : source.held) take(message, fresh);
  }
}

void Feed::wait() {
  std::vector<zmq_pollitem_t> items;
  for (const auto& [topic, source] : sources_) items.push_back({source.subscriber.zmq_socket(), 0, ZMQ_POLLIN, 0});
  (void)::zmq_poll(items.data(), static_cast<int>(items.size()), kTurnNs / 1'000'000);
}

void Feed::receive(Source& source) {
  for (std::size_t i = 0; i < kMessagesATurn; ++i) {
    const auto message = source.subscriber.receive(std::chrono::milliseconds(0));
    if (!message) return;
    if (message->topic() == topics::kEngineCameras.name) follow_asker(*message, source);
    const auto key = latch_key(*message);
    if (key && (source.held.size() < kMaxHeld || source.held.contains(*key)))
      source.held.insert_or_assign(*key, *message);
    const std::string& topic = message->topic();
    bus::guarded(*message, [&] {
      if (topic == topics::kTopics.name) take_topics(message->root<wire::Topics>());
      if (topic == topics::kHeartbeat.name) take_heartbeat(message->root<wire::Heartbeat>());
      if (topic == topics::kLiveness.name) take_liveness(message->root<wire::Liveness>());
    });
    take(*message, wanted_);
  }
}

void Feed::take(const bus::Message& message, const Channels& channels) {
  const std::string& topic = message.topic();
  bus::guarded(message, [&] {
    // A log line is neither held nor repeated: whether somebody wants it by now is the hub's to say.
    if (channels.contains(topic) || topic == topics::kLog.name) take_as_it_is(message);
    if (topic == topics::kLog.name) take_log(message);
    if (topic == topics::kEngineCameras.name) take_cameras(message, channels);
    if (topic == topics::kSceneState.name && channels.contains(std::string(kTransforms))) take_scene(message);
    if (topic == topics::kViewerPose.name) take_pose(message, channels);
    if (topic == topics::kCaptureReference.name) take_reference(message, channels);
    if (topic == topics::kCaptureProbe.name) take_probe(message, channels);
  });
}

void Feed::take_as_it_is(const bus::Message& message) {
  const auto schema = schemas_.find(message.topic());
  if (schema == schemas_.end() || message.header().schema()->string_view() != schema->second) return;
  hub_.deliver(message.topic(), utc(message.header().publish_ns()),
               std::make_shared<const std::string>(reinterpret_cast<const char*>(message.bytes()), message.size()),
               latch_key(message));
}

void Feed::take_topics(const wire::Topics& topics) {
  std::vector<Offer> offers;
  if (topics.topics() == nullptr) return;
  for (const auto* topic : *topics.topics()) {
    const std::string name = bus::printable(topic->name()->string_view(), bus::max_topic_bytes);
    if (name.starts_with("foxglove/") || topic->schemas() == nullptr) continue;
    for (const auto* text : *topic->schemas()) {
      const auto schema = wire::find_schema(text->string_view());
      if (!schema) continue;
      const auto& chosen = schemas_.emplace(name, text->str()).first->second;
      if (chosen != text->string_view()) continue;
      Offer made{.topic = name, .schema_name = std::string(schema->table), .schema = schema->binary};
      if (topic->sources() != nullptr) {
        for (const auto* source : *topic->sources()) made.publishers.push_back(bus::printable(source->string_view()));
      }
      offers.push_back(std::move(made));
      break;
    }
  }
  hub_.offer(Hub::Kind::Bus, offers);
}

void Feed::take_heartbeat(const wire::Heartbeat& heartbeat) {
  const std::string source = heartbeat.header()->source()->str();
  if (is_successor(source)) return;
  NamedParameters parameters;
  if (heartbeat.parameters() != nullptr) {
    for (const auto* one : *heartbeat.parameters()) {
      parameters.push_back({bus::printable(one->key()->string_view()),
                            bus::printable(one->value()->string_view(), kMaxText), one->type()});
    }
  }
  hub_.heard(source, parameters, bus::now_ns());
}

void Feed::take_liveness(const wire::Liveness& liveness) {
  std::map<std::string, bool> sources;
  if (liveness.nodes() != nullptr) {
    for (const auto* node : *liveness.nodes()) {
      if (!is_successor(node->source()->str())) sources[node->source()->str()] = node->alive();
    }
  }
  hub_.listed(sources, bus::now_ns());
}

void Feed::take_log(const bus::Message& message) {
  const auto& log = message.root<wire::Log>();
  const std::string source = message.header().source()->str();
  const std::string text = bus::printable(log.text()->string_view(), kMaxText);
  if (log.level() == wire::LogLevel::Error) hub_.logged_error(source, text);
  const auto level = static_cast<std::uint8_t>(static_cast<int>(log.level()) + 1);  // theirs begin with UNKNOWN
  hub_.deliver(std::string(kLog), time_of(message), log_line(level, source, text, time_of(message)));
}

std::uint64_t Feed::time_of(const bus::Message& message) {
  const std::int64_t captured = message.header().capture_ns();
  return utc(captured > 0 ? captured : message.header().publish_ns());
}

}  // namespace splatbus::gateway::foxglove
