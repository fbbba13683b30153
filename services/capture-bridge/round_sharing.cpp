#include "capture-bridge/round_sharing.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>

#include "bus/clock.h"
#include "bus/error.h"
#include "bus/frames.h"
#include "capture-bridge/round_message.h"
#include "capture-bridge/seniority.h"
#include "wire/sampling_topics.h"
#include "wire/system_generated.h"

namespace splatbus::capture_bridge {

namespace {

constexpr std::size_t kRoundSlots = 3;  // a helper that has nothing else to do copies a round as it comes
constexpr double kLongestMs = 60'000;   // that is believed of a helper's sampling

/// Nullopt when one is gone. Throws bus::Error when they are no samples of that round.
std::optional<std::vector<bus::OutgoingTensor>> forwarded(const bus::Message& message, std::size_t budget) {
  std::vector<bus::OutgoingTensor> tensors;
  for (const char* name : kSampleTensors) {
    auto tensor = message.forward_tensor(name);
    if (!tensor) return std::nullopt;
    tensors.push_back(std::move(*tensor));
  }
  const std::vector<std::uint32_t>& shape = tensors.front().shape;
  if (shape.size() != 2 || shape[0] > budget) {
    throw bus::Error(fmt::format("sampling/result: not samples of a round of {}", budget));
  }
  return tensors;
}

}  // namespace

RoundSharing::RoundSharing(const std::shared_ptr<bus::Context>& context, Device kind, const RoundSizes& expected)
    : own_(context->source()),
      publisher_(context),
      ring_(context, "rounds", kRoundSlots, expected.views * bus::aligned(input_view_bytes(expected.pixels)), kind),
      // As request ids: a bridge in another's place must not take an answer to that one's round for its own.
      last_id_(static_cast<std::uint64_t>(bus::now_ns())) {}

void RoundSharing::take(const wire::Liveness& liveness) {
  if (is_incomplete(liveness) && !helpers_.empty()) return;
  std::map<std::string, Helper> before = std::exchange(helpers_, {});
  for (const Senior& bridge : running(liveness, "capture-bridge")) {
    if (bridge.name == own_) continue;
    const auto known = before.find(bridge.name);
    if (known != before.end() && known->second.epoch == bridge.since_ns) {
      helpers_.insert(before.extract(known));
    } else {
      helpers_[bridge.name].epoch = bridge.since_ns;
    }
  }
  for (auto& [name, gone] : before) come_back(gone);
}

void RoundSharing::offered(const wire::Header& by) {
  const auto helper = helpers_.find(by.source()->str());
  if (helper == helpers_.end() || std::exchange(helper->second.offered_epoch, by.epoch()) == by.epoch()) return;
  spdlog::info("{} samples rounds", bus::printable(helper->first));
  count_anew();
}

void RoundSharing::count_anew() {
  own_pixels_ = 0;
  for (auto& [name, helper] : helpers_) helper.pixels = 0;
}

std::int64_t RoundSharing::pixels_of(const InputJob& job) {
  return static_cast<std::int64_t>(job.views.size() * newest_of(job).pixels());
}

bool RoundSharing::Helper::idle(std::int64_t now_ns) const {
  return offered_epoch == epoch && !in_hand && now_ns >= rests_until_ns;
}

InputJob RoundSharing::Helper::let_go() {
  InputJob job = std::move(in_hand->job);
  in_hand.reset();
  return job;
}

const std::pair<const std::string, RoundSharing::Helper>* RoundSharing::idle(std::int64_t now_ns) const {
  const std::pair<const std::string, Helper>* least = nullptr;
  for (const auto& entry : helpers_) {
    const bool less = least == nullptr || entry.second.pixels < least->second.pixels;
    if (entry.second.idle(now_ns) && less) least = &entry;
  }
  return least;
}

bool RoundSharing::is_anothers_turn(std::int64_t now_ns) const {
  const auto* const other = idle(now_ns);
  return other != nullptr && other->second.pixels < own_pixels_;
}

void RoundSharing::hand(InputJob job, std::int64_t now_ns) {
  const std::string name = idle(now_ns)->first;
  Helper& helper = helpers_.at(name);
  helper.pixels += pixels_of(job);
  helper.in_hand = InHand{.id = ++last_id_, .job = std::move(job), .since_ns = now_ns};
  ++handed_;
  const InputJob& round = helper.in_hand->job;
  const bus::MessageInfo info{.capture_ns = newest_of(round).capture_ns, .tensors = ring_.write(round_tensors(round))};
  publisher_.publish(topics::kSamplingRound, info,
                     [&](auto& builder, auto header) { return write_round(builder, header, name, last_id_, round); });
}

std::optional<RoundSharing::Sampled> RoundSharing::answered(const wire::SamplingResult& result,
                                                            const bus::Message& message, std::int64_t now_ns) {
  const auto known = helpers_.find(message.header().source()->str());
  if (known == helpers_.end() || known->second.epoch != message.header().epoch()) return std::nullopt;
  Helper& helper = known->second;
  const bool has_time = std::isfinite(result.milliseconds()) && result.milliseconds() > 0;
  const double ms = has_time ? std::min<double>(result.milliseconds(), kLongestMs) : 0;
  helper.patience_ns = std::max<std::int64_t>(kPatienceNs, std::llround(4e6 * ms));
  helper.rests_until_ns = 0;
  if (!helper.in_hand || helper.in_hand->id != result.job()) return std::nullopt;
  if (result.refused() != nullptr) {
    helper.rests_until_ns = now_ns + kRestNs;
    come_back(helper);
    spdlog::warn("{} has not sampled a round: {}", bus::printable(known->first),
                 bus::printable(result.refused()->string_view()));
    return std::nullopt;
  }
  Sampled sampled{.job = helper.let_go(),
                  .result = {.tensors = {},
                             .culled = result.culled(),
                             .thinned = result.thinned(),
                             .dropped = {.not_finite = result.not_finite(),
                                         .bad_normal = result.bad_normal(),
                                         .off_ray = result.off_ray()},
                             .milliseconds = ms}};
  const auto give_back = [&] {
    back_.push_back(std::move(sampled.job));
    ++came_back_;
  };
  try {
    auto tensors = forwarded(message, sampled.job.options.budget);
    if (tensors) {
      sampled.result.tensors = std::move(*tensors);
      return sampled;
    }
  } catch (const std::exception&) {
    helper.rests_until_ns = now_ns + kRestNs;
    give_back();
    throw;
  }
  give_back();
  return std::nullopt;
}

void RoundSharing::come_back(Helper& helper) {
  if (!helper.in_hand) return;
  back_.push_back(helper.let_go());
  ++came_back_;
}

std::vector<InputJob> RoundSharing::take_back(std::int64_t now_ns) {
  for (auto& [name, helper] : helpers_) {
    if (!helper.in_hand || now_ns - helper.in_hand->since_ns <= helper.patience_ns) continue;
    spdlog::warn("{} has not answered a round for {:.1f} s", bus::printable(name),
                 static_cast<double>(helper.patience_ns) * 1e-9);
    helper.rests_until_ns = now_ns + kRestNs;
    come_back(helper);
  }
  return std::exchange(back_, {});
}

std::size_t RoundSharing::helpers() const {
  return static_cast<std::size_t>(std::ranges::count_if(
      helpers_, [](const auto& entry) { return entry.second.offered_epoch == entry.second.epoch; }));
}

}  // namespace splatbus::capture_bridge
