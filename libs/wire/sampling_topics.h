#pragma once

#include "wire/topics.h"

namespace splatbus {

namespace wire {
struct SamplingOffer;
struct SamplingResult;
struct SamplingRound;
}  // namespace wire

template <>
inline constexpr std::string_view kSchema<wire::SamplingOffer> = "SamplingOffer/1";
template <>
inline constexpr std::string_view kSchema<wire::SamplingResult> = "SamplingResult/1";
template <>
inline constexpr std::string_view kSchema<wire::SamplingRound> = "SamplingRound/1";

/// Between replicas of the capture-bridge alone.
namespace topics {
inline constexpr Topic<wire::SamplingOffer> kSamplingOffer{"sampling/offer"};
inline constexpr Topic<wire::SamplingRound> kSamplingRound{"sampling/round"};
inline constexpr Topic<wire::SamplingResult> kSamplingResult{"sampling/result"};
}  // namespace topics

}  // namespace splatbus
