#include "bus/heartbeat_check.h"

#include <gmock/gmock.h>

#include <string>
#include <vector>

namespace splatbus::bus_service {
namespace {

using testing::HasSubstr;

/// A heartbeat whose fields have that many bytes, and its lists that many entries.
struct Sizes {
  std::size_t source = 7, service = 7, detail = 10, backend = 4, counters = 10, counter_name = 20, parameters = 10,
              key = 20, value = 100;
};

std::string problem_of(const Sizes& sizes, std::size_t more_bytes = 0) {
  flatbuffers::FlatBufferBuilder builder;
  const auto text = [](std::size_t bytes) { return std::string(bytes, 'x'); };
  std::vector<flatbuffers::Offset<wire::Counter>> counters;
  for (std::size_t i = 0; i < sizes.counters; ++i) {
    counters.push_back(wire::CreateCounterDirect(builder, text(i == 0 ? sizes.counter_name : 1).c_str(), 1));
  }
  std::vector<flatbuffers::Offset<wire::KeyValue>> parameters;
  for (std::size_t i = 0; i < sizes.parameters; ++i) {
    parameters.push_back(wire::CreateKeyValueDirect(builder, text(i == 0 ? sizes.key : 1).c_str(),
                                                    text(i == 0 ? sizes.value : 1).c_str()));
  }
  const auto header = wire::CreateHeaderDirect(builder, "Heartbeat/1", text(sizes.source).c_str(), 1, 1);
  builder.Finish(wire::CreateHeartbeatDirect(builder, header, text(sizes.service).c_str(), 1,
                                             wire::ServiceState::Running, text(sizes.detail).c_str(), &counters,
                                             &parameters, text(sizes.backend).c_str()));
  return heartbeat_problem(*flatbuffers::GetRoot<wire::Heartbeat>(builder.GetBufferPointer()),
                           builder.GetSize() + more_bytes);
}

TEST(HeartbeatCheck, NamesWhatThereIsTooMuchOf) {
  EXPECT_EQ(problem_of({}), "");
  EXPECT_EQ(problem_of({.source = 64,
                        .service = 64,
                        .detail = 4096,
                        .backend = 64,
                        .counters = 1024,
                        .counter_name = 256,
                        .parameters = 1024,
                        .key = 256,
                        .value = 4096}),
            "");
  EXPECT_EQ(problem_of({.source = 65}), "its source has 65 bytes, at most 64 are allowed");
  EXPECT_EQ(problem_of({.service = 65}), "its service has 65 bytes, at most 64 are allowed");
  EXPECT_EQ(problem_of({.detail = 4097}), "its detail has 4097 bytes, at most 4096 are allowed");
  EXPECT_EQ(problem_of({.backend = 65}), "its backend has 65 bytes, at most 64 are allowed");
  EXPECT_EQ(problem_of({.counters = 1025}), "it has 1025 counters, at most 1024 are allowed");
  EXPECT_EQ(problem_of({.counter_name = 257}), "the name of a counter has 257 bytes, at most 256 are allowed");
  EXPECT_EQ(problem_of({.parameters = 1025}), "it has 1025 parameters, at most 1024 are allowed");
  EXPECT_EQ(problem_of({.key = 257}), "the name of a parameter has 257 bytes, at most 256 are allowed");
  EXPECT_EQ(problem_of({.value = 4097}), "the value of a parameter has 4097 bytes, at most 4096 are allowed");
  EXPECT_THAT(problem_of({}, 256 << 10), HasSubstr("at most 262144 are allowed"));
}

}  // namespace
}  // namespace splatbus::bus_service
