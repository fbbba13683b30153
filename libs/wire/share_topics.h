#pragma once

#include "wire/topics.h"

namespace splatbus {

namespace wire {
struct StreamShare;
}  // namespace wire

template <>
inline constexpr std::string_view kSchema<wire::StreamShare> = "StreamShare/1";

/// Between replicas of the streamer alone.
namespace topics {
inline constexpr Topic<wire::StreamShare> kStreamShare{"stream/share"};
}  // namespace topics

}  // namespace splatbus
