#pragma once

#include "wire/topics.h"

namespace splatbus {

namespace wire {
struct Spans;
struct TraceRequest;
}  // namespace wire

template <>
inline constexpr std::string_view kSchema<wire::Spans> = "Spans/1";
template <>
inline constexpr std::string_view kSchema<wire::TraceRequest> = "TraceRequest/1";

/// Those that only `splatbus trace` uses.
namespace topics {
inline constexpr Topic<wire::Spans> kSpans{"sys/spans"};
inline constexpr Topic<wire::TraceRequest> kTraceRequest{"sys/trace"};
}  // namespace topics

}  // namespace splatbus
