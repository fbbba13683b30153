#include "bus/own_messages.h"

#include <unistd.h>

#include <string_view>
#include <vector>

#include "bus/clock.h"
#include "wire/topics.h"

namespace splatbus::bus_service {
namespace {

bus::Frames make_frames(std::string_view topic, const flatbuffers::FlatBufferBuilder& builder) {
  bus::Frames frames;
  frames.topic.rebuild(topic.data(), topic.size());
  frames.body.rebuild(builder.GetBufferPointer(), builder.GetSize());
  return frames;
}

}  // namespace

OwnMessages::OwnMessages() : epoch_(static_cast<std::uint64_t>(bus::now_ns())) {}

flatbuffers::Offset<wire::Header> OwnMessages::header(flatbuffers::FlatBufferBuilder& builder, std::string_view schema,
                                                      std::uint64_t sequence) const {
  const auto schema_text = builder.CreateString(schema);
  const auto source = builder.CreateString(own_source);
  builder.ForceDefaults(true);
  const auto result =
      wire::CreateHeader(builder, schema_text, source, sequence, epoch_, 0, bus::now_ns(), 0, true, source, 0, false);
  builder.ForceDefaults(false);
  return result;
}

bus::Frames OwnMessages::heartbeat(const BrokerStatistics& statistics, wire::ServiceState state) {
  flatbuffers::FlatBufferBuilder builder;
  const auto head = header(builder, splatbus::topics::kHeartbeat.schema, ++heartbeats_);
  const std::pair<const char*, std::uint64_t> counters[] = {
      {"relayed", statistics.relayed}, {"malformed", statistics.malformed},
      {"inlined", statistics.inlined}, {"inline_dropped", statistics.inline_dropped},
      {"held", statistics.held},       {"unheld", statistics.unheld},
      {"slabs", statistics.slabs}};
  std::vector<flatbuffers::Offset<wire::Counter>> offsets;
  offsets.reserve(std::size(counters));
  for (const auto& [name, value] : counters) {
    offsets.push_back(wire::CreateCounterDirect(builder, name, static_cast<double>(value)));
  }
  builder.Finish(wire::CreateHeartbeatDirect(builder, head, own_source, static_cast<std::uint32_t>(::getpid()), state,
                                             nullptr, &offsets, nullptr, nullptr, kProtocolVersion));
  return make_frames(splatbus::topics::kHeartbeat.name, builder);
}

bus::Frames OwnMessages::liveness(const std::map<std::string, Liveness::Node>& nodes) {
  flatbuffers::FlatBufferBuilder builder;
  const auto head = header(builder, splatbus::topics::kLiveness.schema, ++liveness_messages_);
  const std::int64_t now = bus::now_ns();
  std::vector<flatbuffers::Offset<wire::Node>> offsets;
  offsets.reserve(nodes.size());
  for (const auto& [source, node] : nodes) {
    offsets.push_back(wire::CreateNodeDirect(builder, source.c_str(), node.service.c_str(), node.pid, node.epoch,
                                             node.state, node.alive, static_cast<double>(now - node.heard_ns) * 1e-9));
  }
  builder.Finish(wire::CreateLivenessDirect(builder, head, &offsets));
  return make_frames(splatbus::topics::kLiveness.name, builder);
}

bus::Frames OwnMessages::topics(TopicTable& table, const Readers& readers) {
  flatbuffers::FlatBufferBuilder builder;
  const auto head = header(builder, splatbus::topics::kTopics.schema, ++topics_messages_);
  const auto strings = [&](const auto& names) {
    return builder.CreateVectorOfStrings(std::vector<std::string>(names.begin(), names.end()));
  };
  std::vector<flatbuffers::Offset<wire::TopicInfo>> offsets;
  for (auto& [name, topic] : table.topics()) {
    const auto name_offset = builder.CreateString(name);
    const auto schemas = strings(topic.schemas);
    std::vector<std::string> source_names;
    std::vector<std::uint64_t> source_counts;
    for (const auto& [source, messages] : topic.sources) {
      source_names.push_back(source);
      source_counts.push_back(messages);
    }
    const auto sources = strings(source_names);
    const auto source_messages = builder.CreateVector(source_counts);
    const auto subscribers = strings(readers(name));
    const wire::Spread intervals = topic.intervals.take(), transits = topic.transits.take(), ages = topic.ages.take();
    offsets.push_back(wire::CreateTopicInfo(builder, name_offset, schemas, sources, topic.latched, topic.messages,
                                            topic.bytes, topic.shared_bytes, &intervals, &transits, &ages, subscribers,
                                            source_messages));
  }
  builder.Finish(wire::CreateTopicsDirect(builder, head, &offsets));
  return make_frames(splatbus::topics::kTopics.name, builder);
}

}  // namespace splatbus::bus_service
