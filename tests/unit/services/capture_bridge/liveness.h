#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "wire/system_generated.h"

namespace splatbus::capture_bridge::test {

struct Node {
  std::string name;
  std::uint64_t epoch = 1;
  std::string kind = "engine";
  bool alive = true;
  wire::ServiceState state = wire::ServiceState::Running;
};

/// Hands `use` what a broker says that hears these and has been there for so long.
inline void with_liveness(const std::vector<Node>& nodes, std::int64_t publish_ns,
                          const std::function<void(const wire::Liveness&)>& use,
                          std::int64_t broker_age_ns = 10'000'000'000) {
  flatbuffers::FlatBufferBuilder builder;
  const auto schema = builder.CreateString("Liveness/1"), source = builder.CreateString("bus");
  const auto header = wire::CreateHeader(builder, schema, source, 1,
                                         static_cast<std::uint64_t>(publish_ns - broker_age_ns), 0, publish_ns);
  std::vector<flatbuffers::Offset<wire::Node>> all;
  for (const Node& node : nodes) {
    all.push_back(
        wire::CreateNodeDirect(builder, node.name.c_str(), node.kind.c_str(), 1, node.epoch, node.state, node.alive));
  }
  builder.Finish(wire::CreateLivenessDirect(builder, header, &all));
  use(*flatbuffers::GetRoot<wire::Liveness>(builder.GetBufferPointer()));
}

}  // namespace splatbus::capture_bridge::test
