#include "capture-bridge/round_helper.h"

#include <exception>
#include <utility>
#include <vector>

#include "bus/clock.h"
#include "bus/memory.h"
#include "bus/trace.h"
#include "wire/sampling_topics.h"

namespace splatbus::capture_bridge {

RoundHelper::RoundHelper(const std::shared_ptr<bus::Context>& context, Device backend, const RoundSizes& expected)
    : own_(context->source()),
      subscriber_(context),
      publisher_(context),
      pictures_(backend),
      ring_(context, "samples", kSampleSlots, sample_slot_bytes(expected.samples), backend),
      sampler_(backend) {
  subscriber_.on(topics::kSamplingRound, [this](const wire::SamplingRound& round, const bus::Message& message) {
    if (round.to()->string_view() == own_) handle(round, message);
  });
}

void RoundHelper::step(std::chrono::milliseconds timeout) {
  // A round that is given to who cannot hear it yet would be waited for in vain.
  connected_ = connected_ || subscriber_.wait_connected(timeout);
  if (!connected_) return;
  subscriber_.dispatch_all(timeout);
  if (std::exchange(refused_, subscriber_.refused()) != subscriber_.refused()) bus::require_usable(pictures_.kind());
  const std::int64_t now = bus::now_ns();
  if (now < next_offer_ns_) return;
  next_offer_ns_ = now + kOfferEveryNs;
  publisher_.publish(topics::kSamplingOffer,
                     [](auto& builder, auto header) { return wire::CreateSamplingOffer(builder, header); });
}

void RoundHelper::handle(const wire::SamplingRound& round, const bus::Message& message) {
  const std::int64_t capture_ns = message.header().capture_ns();
  const bus::TracedWork work("sample round", capture_ns);
  try {
    const auto read = read_round(round, message, pictures_, host_copied_bytes_);
    if (read) return answer(*read, capture_ns);
    refuse(round.job(), "");
  } catch (const std::exception& error) {
    refuse(round.job(), error.what());
    throw;
  }
}

void RoundHelper::answer(const ForeignRound& round, std::int64_t capture_ns) {
  std::vector<const InputView*> views;
  for (const InputView& view : round.views) views.push_back(&view);
  const std::int64_t begin = bus::now_ns();
  const RoundSamples samples = sampler_.sample(views, round.objects, round.options);
  counters_.milliseconds = static_cast<double>(bus::now_ns() - begin) * 1e-6;
  counters_.samples = samples.size;
  ++counters_.rounds;
  DropCounts dropped;
  for (const DropCounts& counts : samples.dropped) dropped += counts;
  const bus::MessageInfo info{.capture_ns = capture_ns, .tensors = ring_.write(sample_tensors(samples))};
  publisher_.publish(topics::kSamplingResult, info, [&](auto& builder, auto header) {
    return wire::CreateSamplingResult(builder, header, round.job, 0, samples.culled, samples.thinned,
                                      dropped.not_finite, dropped.bad_normal, dropped.off_ray,
                                      static_cast<float>(counters_.milliseconds));
  });
}

void RoundHelper::refuse(std::uint64_t job, const std::string& reason) {
  ++counters_.refused;
  const std::string why = reason.empty() ? "its pictures are gone" : reason;
  publisher_.publish(topics::kSamplingResult, [&](auto& builder, auto header) {
    return wire::CreateSamplingResult(builder, header, job, builder.CreateString(why));
  });
}

}  // namespace splatbus::capture_bridge
